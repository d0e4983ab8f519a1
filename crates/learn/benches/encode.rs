//! What encoding costs: frames through the image encoder, at the demo's size and the paper's. One thread.

#![allow(clippy::unwrap_used, missing_docs)]

mod episodes;

use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput};
use gleaner_core::{OptimSpec, Preset, TrainSpec};
use gleaner_learn::{Policy, Pretrained, Silent, set_threads, train_policy};

const FRAMES: usize = 32;

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let mut group = criterion.benchmark_group("encode_frames");
    group.sample_size(10).measurement_time(Duration::from_secs(4)).throughput(Throughput::Elements(32));
    for (name, (preset, side, depth)) in
        [("tiny_2x32x32_rgb", (Preset::Tiny, 32, false)), ("small_2x128x128_rgbd", (Preset::Small, 128, true))]
    {
        let (model, shape) = episodes::sizes(preset, side, depth);
        let data = episodes::noise(&shape, 1);
        let optim = OptimSpec { steps: 1, batch: 1, ..OptimSpec::default() };
        let spec = TrainSpec { policy: episodes::policy("tf_bc", model), optim, ..TrainSpec::default() };
        let bytes = train_policy(&shape, Pretrained::default(), &data, &[], &spec, None, &mut Silent).unwrap();
        let policy = Policy::load(&bytes).unwrap();
        set_threads(1);
        let (frames, ..) = episodes::arrays(&shape, 0);
        let frames: Vec<&[u8]> = frames.chunks(shape.frame_bytes()).take(FRAMES).collect();
        group.bench_function(BenchmarkId::from_parameter(name), |bencher| bencher.iter(|| policy.embed(&frames)));
    }
    group.finish();
    criterion.final_summary();
}
