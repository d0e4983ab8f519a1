//! Pretraining steps at another program's pace, so that a peer can take turns with them in one run; that
//! peer is `benches/peers`. Without a job it takes a few steps and says what one costs.
//!
//! The one argument is a [`Job`] as JSON. Each line read is a number of steps to take, each line written an
//! object: first the model's size, then what the steps took and gave. Of several ranks, rank 0 is paced and also writes
//! the port of their meeting; the others follow it.

#![allow(clippy::unwrap_used, missing_docs)]

mod episodes;

use std::fs;
use std::io::{self, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::time::Duration;

use gleaner_core::{OptimSpec, Precision, Preset, PretrainSpec, RunSpec};
use gleaner_group::{Meeting, Place};
use gleaner_learn::{
    LearnError, Monitor, Participant, Peers, Silent, TaskShape, Trajectory, pretrain, pretrain_with, set_threads,
};
use serde::Deserialize;
use serde_json::json;

/// More steps than any peer asks for: the run ends when it stops asking.
const ENDLESS: u64 = 1_000_000;
/// Steps without a job, the first of them to warm up.
const STEPS: usize = 23;
const WARM_UP: usize = 3;
const LOCAL: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
/// How long a rank waits for another, which includes the turns of other programs.
const PATIENCE: Duration = Duration::from_secs(600);

/// What to train on, and how.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Job {
    preset: Preset,
    /// Pixels a side of the two cameras.
    side: u32,
    depth: bool,
    episodes: u64,
    objectives: Vec<String>,
    batch: u32,
    stretch: u32,
    threads: u32,
    precision: Precision,
    /// Processes that share each batch, and the number of this one.
    ranks: u32,
    rank: u32,
    /// The port of rank 0's meeting, for the other ranks.
    meeting: u16,
    /// Where the peer finds the episodes and the weights after the first step.
    share: Option<PathBuf>,
}

impl Default for Job {
    fn default() -> Self {
        let optim = OptimSpec::default();
        Self {
            preset: Preset::Tiny,
            side: 32,
            depth: false,
            episodes: 4,
            objectives: PretrainSpec::default().objectives,
            batch: optim.batch,
            stretch: optim.stretch,
            threads: 1,
            precision: Precision::F32,
            ranks: 1,
            rank: 0,
            meeting: 0,
            share: None,
        }
    }
}

/// Keeps the checkpoint of the first step and stops there.
#[derive(Default)]
struct First(Option<Vec<u8>>);

impl Monitor for First {
    fn progress(&mut self, _: u64, _: u64, _: &[(&'static str, f64)]) {}

    fn checkpoint(&mut self, _: u64, bytes: &[u8]) -> Result<(), String> {
        self.0 = Some(bytes.to_vec());
        Ok(())
    }

    fn cancelled(&self) -> bool {
        self.0.is_some()
    }
}

/// Takes steps in blocks, and stops when no further block is asked for.
struct Paced<'a> {
    /// The number of steps of the next block, from the times and values of the last one.
    next: &'a mut dyn FnMut(&Block) -> usize,
    left: usize,
    block: Block,
}

#[derive(Default)]
struct Block {
    ms: Vec<f64>,
    loss: Vec<f64>,
}

impl Monitor for Paced<'_> {
    fn progress(&mut self, _: u64, _: u64, metrics: &[(&'static str, f64)]) {
        let metric = |name| metrics.iter().find(|(known, _)| *known == name).unwrap().1;
        self.block.ms.push(metric("ms_per_step"));
        self.block.loss.push(metric("loss"));
        self.left -= 1;
        if self.left == 0 {
            self.left = (self.next)(&std::mem::take(&mut self.block));
        }
    }

    fn checkpoint(&mut self, _: u64, _: &[u8]) -> Result<(), String> {
        Ok(())
    }

    fn cancelled(&self) -> bool {
        self.left == 0
    }
}

/// Writes the episodes one after the other, as they lie in memory.
fn share(folder: &Path, shape: &TaskShape, episodes: u64) -> io::Result<()> {
    let mut files: [Vec<u8>; 3] = Default::default();
    for seed in 0..episodes {
        let (frames, proprioception, action) = episodes::arrays(shape, seed);
        files[0].extend(frames);
        files[1].extend(proprioception.into_iter().flat_map(f32::to_le_bytes));
        files[2].extend(action.into_iter().flat_map(f32::to_le_bytes));
    }
    let mut named = ["frames", "proprioception", "action"].into_iter().zip(files);
    named.try_for_each(|(name, bytes)| fs::write(folder.join(name), bytes))
}

/// Number of values the model learns; a checkpoint names them so, and nothing else.
fn parameters(checkpoint: &[u8]) -> usize {
    let tensors = safetensors::SafeTensors::deserialize(checkpoint).unwrap();
    let learnt = tensors.iter().filter(|(name, _)| name.starts_with("model."));
    learnt.map(|(_, view)| view.shape().iter().product::<usize>()).sum()
}

fn say(line: &serde_json::Value) {
    let mut out = io::stdout().lock();
    writeln!(out, "{line}").unwrap();
    out.flush().unwrap();
}

/// The number on the next line of standard input; 0 at its end.
fn asked() -> usize {
    let mut line = String::new();
    io::stdin().read_line(&mut line).unwrap();
    line.trim().parse().unwrap_or(0)
}

/// The ranks of the job, once all have come; rank 0 says the model's size before.
fn join(job: &Job, size: usize) -> Peers {
    if job.ranks == 1 {
        say(&json!({"parameters": size}));
        return Peers::alone();
    }
    let meeting = if job.rank == 0 {
        let meeting = Meeting::open(job.ranks, PATIENCE).unwrap();
        say(&json!({"parameters": size, "meeting": meeting.port()}));
        meeting
    } else {
        Meeting::find(SocketAddr::new(LOCAL, job.meeting), job.ranks, PATIENCE).unwrap()
    };
    Peers::of(meeting.join("steps", Place { rank: job.rank, ranks: job.ranks, address: LOCAL, gpu: false }).unwrap())
}

/// What every run of this program has.
struct Run<'a> {
    shape: &'a TaskShape,
    data: &'a [Trajectory],
    spec: &'a PretrainSpec,
    first: &'a [u8],
    peers: Peers,
}

impl Run<'_> {
    /// As many steps as `next` asks for.
    fn paced(self, next: &mut dyn FnMut(&Block) -> usize) {
        let left = next(&Block::default());
        self.ends(&mut Paced { next, left, block: Block::default() });
    }

    fn ends(mut self, monitor: &mut dyn Monitor) {
        let participant = Participant { resume: Some(self.first), peers: &mut self.peers, monitor };
        let ended = pretrain_with(self.shape, self.data, self.spec, None, participant);
        assert!(matches!(ended, Err(LearnError::Cancelled)), "the run ended early: {:?}", ended.err());
    }
}

fn main() {
    let given = std::env::args().skip(1).find(|argument| argument.starts_with('{'));
    let job: Job = given.as_ref().map(|text| serde_json::from_str(text).unwrap()).unwrap_or_default();
    let (model, shape) = episodes::sizes(job.preset, job.side, job.depth);
    let data = episodes::noise(&shape, job.episodes);
    let (batch, stretch, precision) = (job.batch, job.stretch, job.precision);
    let optim = OptimSpec { steps: ENDLESS, batch, stretch, precision, ..OptimSpec::default() };
    let run_of = |checkpoint_every| RunSpec { checkpoint_every, ..RunSpec::default() };
    let once =
        PretrainSpec { model, objectives: job.objectives.clone(), optim, run: run_of(1), ..PretrainSpec::default() };
    set_threads(job.threads);
    let mut first = First::default();
    let ended = pretrain(&shape, &data, &once, None, None, &mut first);
    assert!(matches!(ended, Err(LearnError::Cancelled)), "no first step: {:?}", ended.err());
    let checkpoint = first.0.unwrap();
    if let Some(folder) = &job.share {
        share(folder, &shape, job.episodes).unwrap();
        fs::write(folder.join("checkpoint"), &checkpoint).unwrap();
    }
    let size = parameters(&checkpoint);
    let spec = PretrainSpec { run: run_of(u32::MAX), ..once };
    if given.is_some() {
        let run = Run { shape: &shape, data: &data, spec: &spec, first: &checkpoint, peers: join(&job, size) };
        if job.rank > 0 {
            return run.ends(&mut Silent);
        }
        return run.paced(&mut |block| {
            if !block.ms.is_empty() {
                say(&json!({"ms": block.ms, "loss": block.loss}));
            }
            asked()
        });
    }
    let run = Run { shape: &shape, data: &data, spec: &spec, first: &checkpoint, peers: Peers::alone() };
    run.paced(&mut |block| {
        if block.ms.is_empty() {
            return STEPS;
        }
        let mut ms = block.ms[WARM_UP..].to_vec();
        ms.sort_by(f64::total_cmp);
        say(&json!({"parameters": size, "threads": job.threads, "median_ms": ms[ms.len() / 2]}));
        0
    });
}
