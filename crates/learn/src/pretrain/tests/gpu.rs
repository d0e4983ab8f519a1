//! Pretraining on a GPU beside the processor: losses, metrics, and runs that are stopped, resumed or moved.

use gleaner_core::{Device, Precision, Words as _};

use super::*;
use crate::gpu::{DEVICES, apart, assert_alike, gpu};

fn spec(steps: u64) -> PretrainSpec {
    let augmentation =
        Augmentation { shift_pixels: 2, brightness: 0.1, proprioception_noise: 0.1, ..Augmentation::default() };
    let mut spec = PretrainSpec { augmentation, validation_share: 0.25, ..toy::pretrain_spec(steps) };
    spec.optim.gradient_accumulation = 2;
    spec
}

/// A pretraining on `device`, and its reports to `monitor`.
fn run(
    device: Device,
    spec: &PretrainSpec,
    resume: Option<&[u8]>,
    monitor: &mut Recorder,
) -> Result<Vec<u8>, LearnError> {
    let mut spec = spec.clone();
    spec.run.device = device;
    pretrain(&toy::shape(), &toy::experts(4, 12), &spec, None, resume, monitor)
}

/// The reports of a pretraining to its end.
fn reports(device: Device, spec: &PretrainSpec, resume: Option<&[u8]>) -> Recorder {
    let mut monitor = Recorder::default();
    run(device, spec, resume, &mut monitor).unwrap();
    monitor
}

#[test]
fn losses_on_a_gpu_are_those_of_the_processor_in_each_precision() {
    let Some(_gpu) = gpu() else { return };
    let exact = reports(Device::Cpu, &spec(12), None);
    for word in Precision::ALL {
        let mut spec = spec(12);
        spec.optim.precision = word.value;
        let found = apart(&exact.losses, &reports(Device::Cuda, &spec, None).losses);
        let tolerance = if word.value == Precision::F32 { 1e-3 } else { 0.02 };
        assert!(found < tolerance, "{:?}: {found}", word.value);
        assert!(word.value != Precision::Bf16 || found > 1e-6, "bf16 has an effect");
    }
}

#[test]
fn metrics_that_are_read_together_are_complete_and_in_order() {
    let Some(_gpu) = gpu() else { return };
    // More than twice as many steps as are read together, with checkpoints and losses on held-out episodes among them.
    let spec = toy::every(10, spec(37));
    let [on_cpu, on_gpu] = DEVICES.map(|device| reports(device, &spec, None));
    assert_eq!(on_gpu.losses.len(), 37);
    assert_alike(&on_cpu, &on_gpu, 0.05);
    assert_eq!(on_gpu.checkpoints.iter().map(|(step, _)| *step).collect::<Vec<_>>(), [10, 20, 30]);
}

#[test]
fn a_run_resumes_on_either_device_from_a_checkpoint_of_either() {
    let Some(_gpu) = gpu() else { return };
    let spec = toy::every(4, spec(10));
    let straight = DEVICES.map(|device| reports(device, &spec, None));
    for (from, run) in DEVICES.iter().zip(&straight) {
        let (step, kept) = &run.checkpoints[0];
        assert_eq!(*step, 4);
        for to in DEVICES {
            let found = apart(&straight[0].losses[4..], &reports(to, &spec, Some(kept)).losses);
            assert!(found < 1e-3, "{from:?} to {to:?}: {found}");
        }
    }
}

#[test]
fn a_stop_on_a_gpu_reports_and_keeps_every_step() {
    let Some(_gpu) = gpu() else { return };
    let spec = spec(24);
    let straight = reports(Device::Cpu, &spec, None);
    let mut stopped = Recorder { stop_after: Some(3), ..Recorder::default() };
    let ended = run(Device::Cuda, &spec, None, &mut stopped);
    assert!(matches!(ended, Err(LearnError::Cancelled)), "{ended:?}");
    let taken = stopped.losses.len();
    assert!((3..24).contains(&taken), "{taken}");
    assert_eq!(stopped.checkpoints.len(), 1);
    let (step, kept) = &stopped.checkpoints[0];
    assert_eq!(*step, taken as u64);
    let found = apart(&straight.losses[..taken], &stopped.losses);
    assert!(found < 1e-3, "{found}");
    for device in DEVICES {
        let found = apart(&straight.losses[taken..], &reports(device, &spec, Some(kept)).losses);
        assert!(found < 1e-3, "{device:?}: {found}");
    }
}

#[test]
fn every_choice_of_finished_weights_is_that_of_the_processor() {
    let Some(_gpu) = gpu() else { return };
    for word in FinishedWeights::ALL {
        let mut spec = toy::every(2, spec(6));
        spec.optim.finished_weights = word.value;
        // The last validation loss is of the finished weights.
        let [on_cpu, on_gpu] = DEVICES.map(|device| reports(device, &spec, None));
        assert_alike(&on_cpu, &on_gpu, 0.01);
        let resumed = reports(Device::Cuda, &spec, Some(&on_gpu.checkpoints[1].1));
        let last = |monitor: &Recorder| monitor.metric("loss_validation").pop().unwrap();
        let (expected, found) = (last(&on_cpu), last(&resumed));
        assert!((expected - found).abs() < 0.01 * expected.abs(), "{:?}: {expected} {found}", word.value);
    }
}
