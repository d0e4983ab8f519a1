//! The loop on a line y = a x + b: its batches, its end by a stop or a failure, and its metrics.

mod gpu;

use gleaner_core::{ModelSpec, Precision, Values};
use tch::Device;

use super::*;
use crate::batch::rows;
use crate::checkpoint::{CheckpointKind, FORMAT_VERSION};
use crate::error::guard;
use crate::random::{Purpose, generator, normal};
use crate::toy::{self, Recorder};

/// a and b, `[1, 2]`.
struct Line(Tensor);

impl Learner for Line {
    fn from_named(_: &CheckpointInfo, named: &BTreeMap<String, Tensor>, _: Device) -> Result<Self, LearnError> {
        Ok(Self(named["line"].copy().set_requires_grad(true)))
    }

    fn parameters(&self) -> Vec<(String, Tensor)> {
        vec![("line".to_owned(), self.0.shallow_clone())]
    }

    fn named(&self) -> Vec<(String, Tensor)> {
        self.parameters()
    }
}

fn info() -> CheckpointInfo {
    CheckpointInfo {
        format_version: FORMAT_VERSION,
        kind: CheckpointKind::Encoder,
        step: 0,
        finished: false,
        shape: toy::shape(),
        model: ModelSpec::default(),
        policy: None,
        settings: Values::new(),
        spec: "{}".to_owned(),
    }
}

fn optim() -> OptimSpec {
    OptimSpec { gradient_accumulation: 3, ..toy::optim(6) }
}

fn start() -> Training<Line> {
    Training::start(Line(rows(&[0.5, 0.0], 2, Device::Cpu).set_requires_grad(true)), info(), &optim())
}

/// The same, as on a device whose numbers are read after every fourth step.
fn start_unread() -> Training<Line> {
    Training { unread: Unread::at_once(4), ..start() }
}

/// Values of x, `[8, 1]`.
fn batch(number: u64) -> Tensor {
    rows(&normal(&mut generator(1, Purpose::Batch, number), 8), 1, Device::Cpu)
}

/// The squared error to y = 2 x − 1.
fn loss(line: &Line, x: Tensor) -> Loss {
    let error = line.0.select(1, 0) * &x + line.0.select(1, 1) - (x * 2.0 - 1.0);
    Loss { parts: vec![("mean_error", error.mean(None))], total: error.square().mean(None) }
}

fn run(
    training: Training<Line>,
    assemble: impl Fn(u64) -> Tensor + Send,
    monitor: &mut Recorder,
) -> Result<Vec<u8>, LearnError> {
    let run = (&mut Peers::alone(), monitor as &mut dyn Monitor);
    let made = training.run(100, vec![move |number| Ok(assemble(number))], &loss, &|_, _| Ok(Vec::new()), run)?;
    Ok(made.expect("a process alone leads"))
}

#[test]
fn a_stopped_run_resumes_at_its_next_batch() {
    let mut straight = Recorder::default();
    let finished = run(start(), batch, &mut straight).unwrap();
    for (start, afters) in [(start as fn() -> _, 1..6), (start_unread, 1..5)] {
        for after in afters {
            let mut stopped = Recorder { stop_after: Some(after), ..Recorder::default() };
            assert!(matches!(run(start(), batch, &mut stopped), Err(LearnError::Cancelled)));
            let resumed = Training::<Line>::resume(&stopped.checkpoints[0].1, &info(), &optim(), Device::Cpu).unwrap();
            let Resumed::Unfinished(training) = resumed else { panic!("finished after {after} steps") };
            let mut rest = Recorder::default();
            assert_eq!(run(*training, batch, &mut rest).unwrap(), finished);
            assert_eq!([stopped.losses, rest.losses].concat(), straight.losses);
        }
    }
}

/// Asks for a stop before step `after`, however many steps have been read.
struct StopBefore {
    after: usize,
    asked: std::cell::Cell<usize>,
    seen: Recorder,
}

impl StopBefore {
    fn step(after: usize) -> Self {
        Self { after, asked: std::cell::Cell::new(0), seen: Recorder::default() }
    }
}

impl Monitor for StopBefore {
    fn progress(&mut self, step: u64, total: u64, metrics: &[(&'static str, f64)]) {
        self.seen.progress(step, total, metrics);
    }

    fn checkpoint(&mut self, step: u64, bytes: &[u8]) -> Result<(), String> {
        self.seen.checkpoint(step, bytes)
    }

    fn cancelled(&self) -> bool {
        self.asked.set(self.asked.get() + 1);
        // Before each step, and within it for the other ranks.
        self.asked.get() > 2 * self.after
    }
}

#[test]
fn a_stop_reads_what_was_not_read() {
    let mut straight = Recorder::default();
    let finished = run(start(), batch, &mut straight).unwrap();
    let stop = |after, batch: fn(u64) -> Tensor| {
        let mut stopped = StopBefore::step(after);
        let run_of = (&mut Peers::alone(), &mut stopped as &mut dyn Monitor);
        let ended =
            start_unread().run(100, vec![move |number| Ok(batch(number))], &loss, &|_, _| Ok(Vec::new()), run_of);
        (ended, stopped.seen)
    };
    for after in 1..6 {
        let (ended, seen) = stop(after, batch);
        assert!(matches!(ended, Err(LearnError::Cancelled)));
        assert_eq!(seen.losses, straight.losses[..after], "each step that was taken has its metrics");
        let resumed = Training::<Line>::resume(&seen.checkpoints[0].1, &info(), &optim(), Device::Cpu).unwrap();
        let Resumed::Unfinished(training) = resumed else { panic!("finished after {after} steps") };
        assert_eq!(run(*training, batch, &mut Recorder::default()).unwrap(), finished);
    }
    // A step that diverged and was not read leaves no checkpoint of its weights.
    let (ended, seen) = stop(3, |number| batch(number) * if number < 6 { 1.0 } else { f64::NAN });
    assert!(matches!(ended, Err(LearnError::Diverged { step: 2 })), "{ended:?}");
    assert_eq!((seen.losses.len(), seen.checkpoints.len()), (2, 0));
}

#[test]
fn any_number_of_threads_that_assemble_give_the_same_bytes() {
    let finished = run(start(), batch, &mut Recorder::default()).unwrap();
    for threads in 2..5 {
        let run_of = (&mut Peers::alone(), &mut Silent as &mut dyn Monitor);
        let assemblers = vec![|number| Ok(batch(number)); threads];
        let made = start().run(100, assemblers, &loss, &|_, _| Ok(Vec::new()), run_of).unwrap();
        assert_eq!(made, Some(finished.clone()), "{threads} threads");
    }
}

#[test]
fn steps_that_are_read_together_have_the_metrics_of_steps_read_alone() {
    let run = |training: Training<Line>, every| {
        let mut monitor = Recorder::default();
        let report = |_: &Line, done: u64| Ok(if done == 3 { vec![(LOSS_VALIDATION, 7.0)] } else { Vec::new() });
        let run = (&mut Peers::alone(), &mut monitor as &mut dyn Monitor);
        let made = training.run(every, vec![|number| Ok(batch(number))], &loss, &report, run).unwrap();
        let timed = ["ms_per_step", "ms_per_batch", "waited_share"];
        for metrics in &mut monitor.metrics {
            assert!(timed.iter().all(|name| metrics.remove(*name).is_some()));
        }
        (made, monitor.metrics, monitor.checkpoints)
    };
    for every in [100, 5, 2] {
        let (alone, together) = (run(start(), every), run(start_unread(), every));
        assert_eq!(alone.1.len(), 6);
        assert_eq!(alone.1[2][LOSS_VALIDATION], 7.0);
        assert_eq!(together, alone);
    }
}

#[test]
fn a_batch_that_cannot_be_assembled_ends_the_run_at_its_step_with_its_error() {
    let assemble = |number| {
        assert!(number != 7, "batch 7 has no room");
        batch(number)
    };
    let mut monitor = Recorder::default();
    let message = run(start(), assemble, &mut monitor).unwrap_err().to_string();
    assert!(message.ends_with("batch 7 has no room"), "{message}");
    assert_eq!(monitor.losses.len(), 2, "batches 6, 7 and 8 are of the third step");
}

#[test]
fn a_run_that_fails_ends_with_batches_still_to_come() {
    let fails = |_: &Line, _: Tensor| -> Loss { panic!("of the loss") };
    let run_of = || {
        start().run(
            100,
            vec![|number| Ok(batch(number))],
            &fails,
            &|_, _| Ok(Vec::new()),
            (&mut Peers::alone(), &mut Silent),
        )
    };
    assert!(guard(run_of).unwrap_err().to_string().ends_with("of the loss"));
    let diverges = |number| batch(number) * if number < 6 { 1.0 } else { f64::NAN };
    let diverged = run(start(), diverges, &mut Recorder::default());
    assert!(matches!(diverged, Err(LearnError::Diverged { step: 2 })), "{diverged:?}");
    let mut monitor = Recorder::default();
    let run_of = (&mut Peers::alone(), &mut monitor as &mut dyn Monitor);
    // The step that diverges is one before a checkpoint, which must not be of its weights.
    let diverged =
        start_unread().run(3, vec![move |number| Ok(diverges(number))], &loss, &|_, _| Ok(Vec::new()), run_of);
    assert!(matches!(diverged, Err(LearnError::Diverged { step: 2 })), "{diverged:?}");
    assert_eq!((monitor.losses.len(), monitor.checkpoints.len()), (2, 0));
}

#[test]
fn metrics_are_means_over_the_batches_of_a_step() {
    let mut monitor = Recorder::default();
    run(start(), batch, &mut monitor).unwrap();
    let line = Line(rows(&[0.5, 0.0], 2, Device::Cpu));
    let each: Vec<Loss> = (0..3).map(|number| loss(&line, batch(number))).collect();
    let mean = |value: &dyn Fn(&Loss) -> f64| each.iter().map(value).sum::<f64>() / 3.0;
    let first = &monitor.metrics[0];
    assert!((first["loss"] - mean(&|loss| loss.total.double_value(&[]))).abs() < 1e-6, "{first:?}");
    assert!((first["mean_error"] - mean(&|loss| loss.parts[0].1.double_value(&[]))).abs() < 1e-6, "{first:?}");
    let waited = monitor.metric("waited_share");
    assert!(waited.len() == 6 && waited.iter().all(|share| (0.0..1.0).contains(share)), "{waited:?}");
    assert!(waited[0] > 0.0, "the first batch is not assembled before the first step");
    let assembled = monitor.metric("ms_per_batch");
    assert!(assembled.len() == 6 && assembled.iter().all(|took| *took > 0.0), "{assembled:?}");
}

#[test]
fn tf32_is_allowed_in_steps_and_forbidden_between_them() {
    let _alone = crate::gpu::alone();
    let allowed = |precision| {
        let seen = std::cell::RefCell::new(Vec::new());
        let note = || seen.borrow_mut().push(gleaner_group::tf32_allowed().unwrap());
        let optim = OptimSpec { precision, ..toy::optim(2) };
        let line = Line(rows(&[0.5, 0.0], 2, Device::Cpu).set_requires_grad(true));
        let loss = |line: &Line, x: Tensor| {
            note();
            loss(line, x)
        };
        let report = |_: &Line, _| {
            note();
            Ok(Metrics::new())
        };
        let (mut alone, mut monitor) = (Peers::alone(), Recorder::default());
        let run = (&mut alone, &mut monitor as &mut dyn Monitor);
        Training::start(line, info(), &optim).run(100, vec![|number| Ok(batch(number))], &loss, &report, run).unwrap();
        (seen.into_inner(), monitor.losses)
    };
    let (of_f32, exact) = allowed(Precision::F32);
    let (of_tf32, losses) = allowed(Precision::Tf32);
    assert_eq!(of_f32, [false; 4]);
    assert_eq!(of_tf32, [true, false, true, false]);
    // On a processor it changes nothing.
    assert_eq!(losses, exact);
}
