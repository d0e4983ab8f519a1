//! The loop on a GPU: metrics of steps that are read together, stops, divergence, and steps that wait for no result.

use std::cell::RefCell;

use super::*;
use crate::device::send;
use crate::gpu::{GPU, apart, assert_alike, busy, gpu};

fn start_on_gpu() -> Training<Line> {
    Training::start(Line(rows(&[0.5, 0.0], 2, GPU).set_requires_grad(true)), info(), &optim())
}

fn batch_on_gpu(number: u64) -> Tensor {
    send(&batch(number), GPU)
}

#[test]
fn steps_that_are_read_together_on_a_gpu_have_the_metrics_of_the_processor() {
    let Some(_gpu) = gpu() else { return };
    let reports = |training: Training<Line>, every, assemble: fn(u64) -> Tensor| {
        let mut monitor = Recorder::default();
        let report = |_: &Line, done: u64| Ok(if done == 3 { vec![(LOSS_VALIDATION, 7.0)] } else { Vec::new() });
        let run = (&mut Peers::alone(), &mut monitor as &mut dyn Monitor);
        training.run(every, vec![move |number| Ok(assemble(number))], &loss, &report, run).unwrap();
        monitor
    };
    for every in [100, 5, 2] {
        let (on_cpu, on_gpu) = (reports(start(), every, batch), reports(start_on_gpu(), every, batch_on_gpu));
        assert_eq!(on_gpu.losses.len(), 6);
        assert_alike(&on_cpu, &on_gpu, 1e-3);
        let steps = |monitor: &Recorder| monitor.checkpoints.iter().map(|(step, _)| *step).collect::<Vec<u64>>();
        assert_eq!(steps(&on_gpu), steps(&on_cpu));
    }
}

#[test]
fn a_stop_on_a_gpu_reads_what_was_not_read_and_the_processor_resumes() {
    let Some(_gpu) = gpu() else { return };
    let mut straight = Recorder::default();
    run(start(), batch, &mut straight).unwrap();
    for after in 1..6 {
        let mut stopped = StopBefore::step(after);
        let run_of = (&mut Peers::alone(), &mut stopped as &mut dyn Monitor);
        let ended =
            start_on_gpu().run(100, vec![|number| Ok(batch_on_gpu(number))], &loss, &|_, _| Ok(Vec::new()), run_of);
        assert!(matches!(ended, Err(LearnError::Cancelled)), "{ended:?}");
        let seen = stopped.seen;
        assert!(apart(&straight.losses[..after], &seen.losses) < 1e-4, "{:?}", seen.losses);
        let resumed = Training::<Line>::resume(&seen.checkpoints[0].1, &info(), &optim(), Device::Cpu).unwrap();
        let Resumed::Unfinished(training) = resumed else { panic!("finished after {after} steps") };
        let mut rest = Recorder::default();
        run(*training, batch, &mut rest).unwrap();
        assert!(apart(&straight.losses[after..], &rest.losses) < 1e-4, "{:?}", rest.losses);
    }
}

#[test]
fn a_step_that_diverged_on_a_gpu_is_named_and_leaves_no_checkpoint() {
    let Some(_gpu) = gpu() else { return };
    let diverges = |number: u64| batch_on_gpu(number) * if number < 6 { 1.0 } else { f64::NAN };
    let mut monitor = Recorder::default();
    let diverged = run(start_on_gpu(), diverges, &mut monitor);
    assert!(matches!(diverged, Err(LearnError::Diverged { step: 2 })), "{diverged:?}");
    assert_eq!((monitor.losses.len(), monitor.checkpoints.len()), (2, 0));
}

/// Gives the GPU other work before the first step, and notes when it is asked for a stop: before each step and after
/// its gradients.
#[derive(Default)]
struct Busy(RefCell<Vec<Instant>>);

impl Monitor for Busy {
    fn progress(&mut self, _: u64, _: u64, _: &[(&'static str, f64)]) {}

    fn checkpoint(&mut self, _: u64, _: &[u8]) -> Result<(), String> {
        Ok(())
    }

    fn cancelled(&self) -> bool {
        let mut asked = self.0.borrow_mut();
        if asked.is_empty() {
            busy();
        }
        asked.push(Instant::now());
        false
    }
}

#[test]
fn steps_do_not_wait_for_the_gpu_until_they_are_read() {
    let Some(_gpu) = gpu() else { return };
    // The time from before the first step until the gradients of the last one, and until the end.
    let times = || {
        let batches: Vec<Tensor> = (0..6).map(batch_on_gpu).collect();
        let of_batch = |line: &Line, number: usize| loss(line, batches[number].shallow_clone());
        // Few enough operations that the GPU's queue has room for all of them.
        let training = Training { optim: OptimSpec { gradient_accumulation: 1, ..optim() }, ..start_on_gpu() };
        let mut monitor = Busy::default();
        let run_of = (&mut Peers::alone(), &mut monitor as &mut dyn Monitor);
        let assemble = |number: u64| Ok(usize::try_from(number).unwrap());
        training.run(100, vec![assemble], &of_batch, &|_, _| Ok(Vec::new()), run_of).unwrap();
        let (end, asked) = (Instant::now(), monitor.0.into_inner());
        assert_eq!(asked.len(), 12);
        (asked[11] - asked[0], end - asked[0])
    };
    // The GPU's programs are loaded at their first use, which waits.
    times();
    let (steps, all) = times();
    assert!(steps * 2 < all, "the steps took {steps:?} of {all:?}");
}
