//! Prints how fast this machine pretrains, scores and acts, on episodes of noise. Knows only the
//! public interface. Arguments: preset, image side, depth (0 or 1), threads.

#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]

use std::sync::Arc;
use std::time::Instant;

use gleaner_learn::{
    CameraShape, FrameBytes, History, LearnError, ModelSpec, Monitor, OptimSpec, Policy, Preset, PretrainSpec,
    ScoreSpec, Silent, TaskShape, TrainSpec, Trajectory, pretrain, score, set_threads, train_policy,
};

const STEPS: usize = 100;

/// Collects the milliseconds of each step.
#[derive(Default)]
struct Times(Vec<f64>);

impl Monitor for Times {
    fn progress(&mut self, _: u64, _: u64, metrics: &[(&'static str, f64)]) {
        let time = metrics.iter().find(|(name, _)| *name == "ms_per_step");
        self.0.extend(time.map(|(_, ms)| *ms));
    }

    fn checkpoint(&mut self, _: u64, _: &[u8]) -> Result<(), String> {
        Ok(())
    }

    fn cancelled(&self) -> bool {
        false
    }
}

impl Times {
    fn median(mut self) -> f64 {
        self.0.sort_by(f64::total_cmp);
        self.0[self.0.len() / 2]
    }
}

/// A cheap stream of bytes that do not repeat.
fn noise(seed: usize, count: usize) -> Vec<u8> {
    let mut state = u64::try_from(seed).unwrap() * 2 + 1;
    let next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        state.to_be_bytes()[0]
    };
    std::iter::repeat_with(next).take(count).collect()
}

fn episode(shape: &TaskShape, seed: usize) -> Result<Trajectory, LearnError> {
    let frames: FrameBytes = Arc::new(noise(seed, STEPS * shape.frame_bytes()));
    let floats = |seed, width| {
        let bytes = noise(seed, STEPS * width);
        bytes.iter().map(|byte| f32::from(*byte) / 128.0 - 1.0).collect()
    };
    let (m, a) = (floats(seed + 1, shape.proprioception), floats(seed + 2, shape.action));
    Trajectory::new(shape, format!("episode {seed}"), frames, m, a)
}

fn main() -> Result<(), LearnError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let argument = |at: usize, default: &str| arguments.get(at).cloned().unwrap_or_else(|| default.to_owned());
    let preset = match argument(0, "tiny").as_str() {
        "base" => Preset::Base,
        "small" => Preset::Small,
        _ => Preset::Tiny,
    };
    let side: u32 = argument(1, "32").parse().unwrap();
    let depth = argument(2, "0") == "1";
    let threads: u32 = argument(3, "2").parse().unwrap();
    let camera = |name: &str| CameraShape { name: name.into(), height: side, width: side, depth };
    let shape = TaskShape { cameras: vec![camera("top"), camera("hand")], proprioception: 38, action: 7 };
    println!("{preset:?}, 2 cameras of {side}x{side}, depth {depth}, {threads} threads");
    set_threads(threads);
    let data: Vec<Trajectory> = (0..8).map(|seed| episode(&shape, seed)).collect::<Result<_, _>>()?;
    let encoder = measure_training(&shape, &data, preset)?;
    measure_scoring(&encoder, &data)?;
    measure_acting(&shape, &encoder, &data)
}

fn optim(steps: u64) -> OptimSpec {
    OptimSpec { steps, ..OptimSpec::default() }
}

fn measure_training(shape: &TaskShape, data: &[Trajectory], preset: Preset) -> Result<Vec<u8>, LearnError> {
    let spec = PretrainSpec {
        model: ModelSpec { preset, ..ModelSpec::default() },
        optim: optim(15),
        ..PretrainSpec::default()
    };
    let mut times = Times::default();
    let encoder = pretrain(shape, data, &spec, None, &mut times)?;
    println!("pretrain: {:.0} ms a step of 64 segments", times.median());
    let spec = TrainSpec { optim: optim(15), ..TrainSpec::default() };
    let mut times = Times::default();
    train_policy(shape, Some(&encoder), data, &[], &spec, None, &mut times)?;
    println!("finetune: {:.0} ms a step of 64 expert segments", times.median());
    Ok(encoder)
}

fn measure_scoring(encoder: &[u8], data: &[Trajectory]) -> Result<(), LearnError> {
    let begin = Instant::now();
    let scores = score(encoder, &data[..4], &data[4..], &ScoreSpec::default(), &mut Silent)?;
    let segments: usize = scores.imperfect.iter().chain(&scores.experts).map(|e| e.w.len()).sum();
    let seconds = begin.elapsed().as_secs_f64();
    println!("score: {:.0} segments a second", f64::from(u32::try_from(segments).unwrap()) / seconds);
    Ok(())
}

fn measure_acting(shape: &TaskShape, encoder: &[u8], data: &[Trajectory]) -> Result<(), LearnError> {
    set_threads(1);
    let spec = TrainSpec { optim: optim(1), ..TrainSpec::default() };
    let policy = Policy::load(&train_policy(shape, Some(encoder), data, &[], &spec, None, &mut Silent)?)?;
    let bytes = data[0].frames.as_ref().as_ref();
    for sessions in [1, 4, 16] {
        let frames = vec![&bytes[..shape.frame_bytes()]; sessions];
        let mut histories = vec![History::new(policy.segment_length()); sessions];
        let mut times = Times::default();
        for _ in 0..100 {
            let begin = Instant::now();
            for (history, embedding) in histories.iter_mut().zip(policy.embed(&frames)?) {
                history.push(embedding, vec![0.5; 38])?;
            }
            let actions = policy.act(&histories.iter().collect::<Vec<_>>())?;
            times.0.push(begin.elapsed().as_secs_f64() * 1e3);
            for (history, mut actions) in histories.iter_mut().zip(actions) {
                history.set_executed(actions.remove(0))?;
            }
        }
        println!("act: {:.2} ms (median) to embed and act for {sessions}, 1 thread", times.median());
    }
    Ok(())
}
