//! Computing on a GPU: what its tests share, and tests of tensors alone. Those of each part are in its module `gpu`.
//! Without a GPU they print SKIPPED and pass (`make test-gpu`).

use std::io::Write as _;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tch::{Cuda, Kind, Tensor};

use crate::device::{self, Tf32, send};
use crate::toy::{self, Recorder};
use gleaner_core::{Device, Precision};

/// The processor and the GPU, as settings name them.
pub(crate) const DEVICES: [Device; 2] = [Device::Cpu, Device::Cuda];

/// The GPU, as the tensor library names it.
pub(crate) const GPU: tch::Device = tch::Device::Cuda(0);

/// Metrics that measure time.
const OF_TIME: [&str; 3] = ["ms_per_step", "ms_per_batch", "waited_share"];

/// For a test that depends on TF32, which is a switch of the whole process: until this is dropped, no other one runs.
pub(crate) fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The lock on the GPU for one test. On a machine without a GPU it prints SKIPPED and returns `None`.
pub(crate) fn gpu() -> Option<MutexGuard<'static, ()>> {
    if Cuda::is_available() {
        return Some(alone());
    }
    // Not by a macro, whose output the test harness captures.
    std::io::stderr().write_all(b"SKIPPED: no GPU\n").unwrap();
    None
}

/// Queues products that keep the GPU busy for some tenths of a second.
pub(crate) fn busy() {
    let zeros = Tensor::zeros([6144, 6144], (Kind::Float, GPU));
    drop((0..64).fold(zeros.shallow_clone(), |product, _| product.matmul(&zeros)));
}

/// The largest difference of the losses of the same steps, relative to the first, or to the loss itself where that is
/// larger.
pub(crate) fn apart(expected: &[(u64, f64)], found: &[(u64, f64)]) -> f64 {
    let steps = |losses: &[(u64, f64)]| losses.iter().map(|(step, _)| *step).collect::<Vec<u64>>();
    assert_eq!(steps(found), steps(expected));
    assert!(found.iter().all(|(_, loss)| loss.is_finite()), "{found:?}");
    let first = expected[0].1.abs();
    let pairs = expected.iter().zip(found);
    pairs.map(|((_, expected), (_, found))| (expected - found).abs() / expected.abs().max(first)).fold(0.0, f64::max)
}

/// Fails unless both have the same metrics of the same steps, in order, all of them numbers.
pub(crate) fn assert_complete(expected: &Recorder, found: &Recorder) {
    let steps = |monitor: &Recorder| monitor.losses.iter().map(|(step, _)| *step).collect::<Vec<u64>>();
    assert_eq!(steps(found), steps(expected));
    assert!(steps(found).is_sorted_by(|one, next| one + 1 == *next), "{:?}", found.losses);
    for ((step, _), (expected, found)) in found.losses.iter().zip(expected.metrics.iter().zip(&found.metrics)) {
        assert!(found.keys().eq(expected.keys()), "step {step}: {found:?} {expected:?}");
        assert!(found.values().all(|value| value.is_finite()), "step {step}: {found:?}");
        assert!(OF_TIME.iter().all(|name| found[name] >= 0.0), "step {step}: {found:?}");
    }
}

/// As [`assert_complete`]; fails also if a metric that does not measure time differs by this share of it.
pub(crate) fn assert_alike(expected: &Recorder, found: &Recorder, tolerance: f64) {
    assert_complete(expected, found);
    for ((step, _), (expected, found)) in found.losses.iter().zip(expected.metrics.iter().zip(&found.metrics)) {
        for (name, value) in expected.iter().filter(|(name, _)| !OF_TIME.contains(name)) {
            let difference = (value - found[name]).abs() / value.abs().max(1e-2);
            assert!(difference < tolerance, "step {step}: {name} is {value} and {}", found[name]);
        }
    }
}

#[test]
fn tensors_arrive_whole_on_a_gpu_though_their_source_is_freed() {
    let Some(_gpu) = gpu() else { return };
    let kinds = [Kind::Float, Kind::Uint8, Kind::Int64, Kind::Bool];
    let drawn = |number: u64| {
        let kind = kinds[usize::try_from(number).unwrap() % kinds.len()];
        (toy::numbers(&[64, 1024], number) * 20.0).abs().to_kind(kind)
    };
    // The copies wait for the GPU while their sources are freed, and later sources take their memory.
    busy();
    let sent: Vec<Tensor> = (0..32).map(|number| send(&drawn(number), GPU)).collect();
    for (number, sent) in (0..).zip(&sent) {
        let source = drawn(number);
        assert_eq!((sent.device(), sent.kind(), sent.size()), (GPU, source.kind(), source.size()));
        assert!(sent.to_device(tch::Device::Cpu).equal(&source), "{number}");
    }
}

#[test]
fn products_on_a_gpu_have_all_digits_of_f32_except_with_tf32() {
    let Some(_gpu) = gpu() else { return };
    let [left, right] = [1, 2].map(|seed| toy::numbers(&[256, 256], seed));
    let (pictures, kernels) = (toy::numbers(&[8, 16, 16, 16], 3), toy::numbers(&[32, 16, 3, 3], 4));
    let products = |kind: Kind, device: tch::Device| {
        let on = |tensor: &Tensor| tensor.to_kind(kind).to_device(device);
        let product = on(&left).matmul(&on(&right));
        let convolved = on(&pictures).conv2d(&on(&kernels), None::<&Tensor>, [1, 1], [1, 1], [1, 1], 1);
        [product, convolved].map(|found| found.to_device(tch::Device::Cpu).to_kind(Kind::Double))
    };
    let exact = products(Kind::Double, tch::Device::Cpu);
    let error = || {
        let found = products(Kind::Float, GPU);
        let largest = |tensor: &Tensor| tensor.abs().max().double_value(&[]);
        exact.iter().zip(&found).map(|(exact, found)| largest(&(exact - found)) / largest(exact)).fold(0.0, f64::max)
    };
    device::open(Device::Cuda, None).unwrap();
    let full = error();
    assert!(full < 5e-5, "{full}");
    let tf32 = Tf32::of(Precision::Tf32).unwrap();
    let reduced = error();
    assert!(reduced < 1e-2, "{reduced}");
    drop(tf32);
    let again = error();
    assert!(again < 5e-5, "{again}");
}
