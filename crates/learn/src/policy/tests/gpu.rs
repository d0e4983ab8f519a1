//! Every policy on a GPU beside the processor: its training, its actions on both, and runs that change the device.

use gleaner_core::{Device, Precision};

use super::*;
use crate::gpu::{DEVICES, apart, assert_complete, gpu};

/// A training of `steps` steps on `device`, with a checkpoint after three of them.
fn trained(
    form: &str,
    (steps, device, precision): (u64, Device, Precision),
    encoder: &[u8],
    resume: Option<&[u8]>,
) -> (Vec<u8>, Recorder) {
    let mut spec = TrainSpec { validation_share: 0.25, ..spec(form, steps) };
    (spec.optim.precision, spec.run.device, spec.run.checkpoint_every) = (precision, device, 3);
    let mut monitor = Recorder::default();
    let made = train_policy(
        &toy::shape(),
        Pretrained::encoder(encoder),
        &toy::experts(4, 12),
        &kept(0.9),
        &spec,
        resume,
        &mut monitor,
    );
    (made.unwrap(), monitor)
}

/// The actions of a policy after several histories.
fn actions(policy: &Policy) -> Vec<f32> {
    let histories = [(0.1, 0.05), (0.5, -0.1), (0.9, 0.02)];
    histories.into_iter().flat_map(|(seen, executed)| acted(policy, seen, executed).concat().concat()).collect()
}

/// The largest difference of actions.
fn farthest(expected: &[f32], found: &[f32]) -> f32 {
    assert_eq!(expected.len(), found.len());
    assert!(found.iter().all(|action| action.is_finite()), "{found:?}");
    expected.iter().zip(found).map(|(expected, found)| (expected - found).abs()).fold(0.0, f32::max)
}

#[test]
fn every_policy_trains_on_a_gpu_as_on_the_processor_and_acts_alike_on_both() {
    let Some(_gpu) = gpu() else { return };
    let encoder = encoder(2);
    for form in forms() {
        let [(by_cpu, on_cpu), (by_gpu, on_gpu)] =
            DEVICES.map(|device| trained(form, (8, device, Precision::F32), &encoder, None));
        let found = apart(&on_cpu.losses, &on_gpu.losses);
        assert!(found < 5e-3, "{form}: {found}");
        assert_complete(&on_cpu, &on_gpu);
        let served = actions(&Policy::load(&by_gpu).unwrap());
        let found = farthest(&actions(&Policy::load(&by_cpu).unwrap()), &served);
        assert!(found < 0.02, "{form}: trained on the GPU its actions differ by {found}");
        let found = farthest(&served, &actions(&Policy::load_on(&by_gpu, Device::Cuda).unwrap()));
        assert!(found < 1e-3, "{form}: served on the GPU its actions differ by {found}");
    }
}

#[test]
fn every_policy_resumes_on_either_device_from_a_checkpoint_of_either() {
    let Some(_gpu) = gpu() else { return };
    let encoder = encoder(2);
    for form in forms() {
        let straight = DEVICES.map(|device| trained(form, (6, device, Precision::F32), &encoder, None).1);
        for (from, run) in DEVICES.iter().zip(&straight) {
            let (step, kept) = &run.checkpoints[0];
            assert_eq!(*step, 3);
            for to in DEVICES {
                let (_, rest) = trained(form, (6, to, Precision::F32), &encoder, Some(kept));
                let found = apart(&straight[0].losses[3..], &rest.losses);
                assert!(found < 5e-3, "{form}, {from:?} to {to:?}: {found}");
            }
        }
    }
}

#[test]
fn every_policy_trains_on_a_gpu_in_reduced_precision_as_in_f32() {
    let Some(_gpu) = gpu() else { return };
    let encoder = encoder(2);
    for form in forms() {
        let losses = |device, precision| trained(form, (8, device, precision), &encoder, None).1.losses;
        let exact = losses(Device::Cpu, Precision::F32);
        for precision in [Precision::Bf16, Precision::Tf32] {
            let found = apart(&exact, &losses(Device::Cuda, precision));
            assert!(found < 0.03, "{form}, {precision:?}: {found}");
        }
    }
}
