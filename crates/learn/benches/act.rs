//! What acting costs: one control step of 1 and of 16 sessions in one pass, frames encoded once each,
//! for policies of chunks and for the transformer with a full history. One thread.

#![allow(clippy::unwrap_used, missing_docs)]

mod episodes;

use std::time::Duration;

use criterion::{BatchSize, BenchmarkId, Criterion};
use gleaner_core::{OptimSpec, Preset, TrainSpec};
use gleaner_learn::{History, Policy, Pretrained, Silent, set_threads, train_policy};

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let (model, shape) = episodes::sizes(Preset::Tiny, 32, false);
    let data = episodes::noise(&shape, 1);
    let mut group = criterion.benchmark_group("act");
    group.sample_size(30).measurement_time(Duration::from_secs(3));
    for policy in ["act", "tf_bc", "flow", "diffusion"] {
        let optim = OptimSpec { steps: 1, batch: 1, ..OptimSpec::default() };
        let spec = TrainSpec { policy: episodes::policy(policy, model), optim, ..TrainSpec::default() };
        let bytes = train_policy(&shape, Pretrained::default(), &data, &[], &spec, None, &mut Silent).unwrap();
        let policy = Policy::load(&bytes).unwrap();
        set_threads(1);
        let (frames, ..) = episodes::arrays(&shape, 0);
        let frame = &frames[..shape.frame_bytes()];
        for sessions in [1, 16] {
            let frames = vec![frame; sessions];
            let histories = vec![full(&policy, frame); sessions];
            let step = |mut histories: Vec<History>| {
                for (history, embedding) in histories.iter_mut().zip(policy.embed(&frames).unwrap()) {
                    history.push(embedding, vec![0.5; shape.proprioception]).unwrap();
                }
                policy.act(&histories.iter().collect::<Vec<_>>()).unwrap()
            };
            group.bench_function(BenchmarkId::new(policy.kind(), sessions), |bencher| {
                bencher.iter_batched(|| histories.clone(), step, BatchSize::SmallInput);
            });
        }
    }
    group.finish();
    criterion.final_summary();
}

/// A history that is full but for the newest step.
fn full(policy: &Policy, frame: &[u8]) -> History {
    let mut history = History::new(policy.segment_length());
    for _ in 0..policy.segment_length() {
        let embedding = policy.embed(&[frame]).unwrap().remove(0);
        history.push(embedding, vec![0.5; policy.shape().proprioception]).unwrap();
        history.set_executed(vec![0.5; policy.shape().action]).unwrap();
    }
    history
}
