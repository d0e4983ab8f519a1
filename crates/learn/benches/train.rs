//! What a training step costs: pretraining with every objective and alone, and each policy. A batch
//! is 64 segments in stretches of 8; a policy's step takes an expert batch and a kept one. One thread.

#![allow(clippy::unwrap_used, missing_docs)]

mod episodes;

use std::time::Duration;

use criterion::{BenchmarkId, Criterion, SamplingMode};
use gleaner_core::kinds::Family;
use gleaner_core::{OptimSpec, Preset, PretrainSpec, TrainSpec};
use gleaner_learn::{Monitor, Pretrained, Silent, TaskShape, Trajectory, WeightedSegments, pretrain, train_policy};

const THREADS: Option<u32> = Some(1);

/// Adds up what the steps took, less what a run does once.
#[derive(Default)]
struct Steps(f64);

impl Monitor for Steps {
    fn progress(&mut self, _: u64, _: u64, metrics: &[(&'static str, f64)]) {
        self.0 += metrics.iter().find(|(name, _)| *name == "ms_per_step").unwrap().1;
    }

    fn checkpoint(&mut self, _: u64, _: &[u8]) -> Result<(), String> {
        Ok(())
    }

    fn cancelled(&self) -> bool {
        false
    }
}

impl Steps {
    fn time(self) -> Duration {
        Duration::from_secs_f64(self.0 / 1e3)
    }
}

fn optim(steps: u64) -> OptimSpec {
    OptimSpec { steps, ..OptimSpec::default() }
}

fn pretrain_step(criterion: &mut Criterion, shape: &TaskShape, data: &[Trajectory], spec: &PretrainSpec) {
    let mut group = criterion.benchmark_group("pretrain_step");
    group.sample_size(10).sampling_mode(SamplingMode::Flat).measurement_time(Duration::from_secs(4));
    for (name, objectives) in [("all", PretrainSpec::default().objectives), ("aa", vec!["aa".to_owned()])] {
        group.bench_function(BenchmarkId::from_parameter(name), |bencher| {
            bencher.iter_custom(|steps| {
                let spec = PretrainSpec { objectives: objectives.clone(), optim: optim(steps), ..spec.clone() };
                let mut time = Steps::default();
                pretrain(shape, data, &spec, None, None, &mut time).unwrap();
                time.time()
            });
        });
    }
}

fn policy_step(criterion: &mut Criterion, shape: &TaskShape, data: &[Trajectory], spec: &PretrainSpec) {
    let encoder =
        pretrain(shape, data, &PretrainSpec { optim: optim(1), ..spec.clone() }, None, None, &mut Silent).unwrap();
    let kept = [WeightedSegments { trajectory: data[0].clone(), steps: (0..100).map(|step| (step, 0.95)).collect() }];
    let mut group = criterion.benchmark_group("policy_step");
    group.sample_size(10).sampling_mode(SamplingMode::Flat).measurement_time(Duration::from_secs(4));
    for kind in Family::Policy.kinds() {
        group.bench_function(BenchmarkId::from_parameter(&kind.name), |bencher| {
            bencher.iter_custom(|steps| {
                let spec = TrainSpec {
                    policy: episodes::policy(&kind.name, spec.model),
                    optim: optim(steps),
                    threads: THREADS,
                    ..Default::default()
                };
                let mut time = Steps::default();
                train_policy(shape, Pretrained::encoder(&encoder), data, &kept, &spec, None, &mut time).unwrap();
                time.time()
            });
        });
    }
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let (model, shape) = episodes::sizes(Preset::Tiny, 32, false);
    let data = episodes::noise(&shape, 8);
    let spec = PretrainSpec { model, threads: THREADS, ..PretrainSpec::default() };
    pretrain_step(&mut criterion, &shape, &data, &spec);
    policy_step(&mut criterion, &shape, &data, &spec);
    criterion.final_summary();
}
