//! A pretraining step in f32 and in bf16, in turns, at the demo's size and the paper's; and the share of the step's time
//! that it waited for its batch. One thread, or the number in the variable `THREADS`.

#![allow(clippy::unwrap_used, missing_docs)]

mod episodes;

use std::io::{self, Write};

use gleaner_core::{OptimSpec, Precision, Preset, PretrainSpec};
use gleaner_learn::{Monitor, TaskShape, Trajectory, pretrain};

const ROUNDS: usize = 5;
/// Steps of a round, of which the first ones warm up.
const STEPS: usize = 8;
const WARM_UP: usize = 3;

/// The metrics of the steps after the warm-up.
#[derive(Default)]
struct Steps {
    ms: Vec<f64>,
    waited: Vec<f64>,
    seen: usize,
}

impl Monitor for Steps {
    fn progress(&mut self, _: u64, _: u64, metrics: &[(&'static str, f64)]) {
        let metric = |name| metrics.iter().find(|(known, _)| *known == name).unwrap().1;
        self.seen += 1;
        if self.seen > WARM_UP {
            self.ms.push(metric("ms_per_step"));
            self.waited.push(metric("waited_share"));
        }
    }

    fn checkpoint(&mut self, _: u64, _: &[u8]) -> Result<(), String> {
        Ok(())
    }

    fn cancelled(&self) -> bool {
        false
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The medians of a round: milliseconds of a step, and the share of it that was waited.
fn round(shape: &TaskShape, data: &[Trajectory], spec: &PretrainSpec, precision: Precision) -> [f64; 2] {
    let optim = OptimSpec { steps: STEPS as u64, precision, ..OptimSpec::default() };
    let mut steps = Steps::default();
    pretrain(shape, data, &PretrainSpec { optim, ..spec.clone() }, None, None, &mut steps).unwrap();
    [median(&mut steps.ms), median(&mut steps.waited)]
}

fn main() {
    let mut out = io::stdout().lock();
    let threads = std::env::var("THREADS").map_or(1, |threads| threads.parse().unwrap());
    let sizes = [("tiny, 2×32² RGB", Preset::Tiny, 32, false), ("small, 2×128² RGBD", Preset::Small, 128, true)];
    for (name, preset, side, depth) in sizes {
        let (model, shape) = episodes::sizes(preset, side, depth);
        let data = episodes::noise(&shape, 2);
        let spec = PretrainSpec { model, threads: Some(threads), ..PretrainSpec::default() };
        let (mut ms, mut waited, mut ratios) = ([const { Vec::new() }; 2], Vec::new(), Vec::new());
        for _ in 0..ROUNDS {
            let both = [Precision::F32, Precision::Bf16].map(|precision| round(&shape, &data, &spec, precision));
            ratios.push(both[1][0] / both[0][0]);
            for (all, [each, share]) in ms.iter_mut().zip(both) {
                all.push(each);
                waited.push(share);
            }
        }
        let [exact, reduced] = ms.map(|mut all| median(&mut all));
        writeln!(
            out,
            "{name}, threads {threads}: f32 {exact:.1} ms, bf16 {reduced:.1} ms, ratio {:.2}, waited {:.1} %",
            median(&mut ratios),
            100.0 * median(&mut waited)
        )
        .unwrap();
    }
}
