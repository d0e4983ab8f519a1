//! The optimiser on a GPU beside the processor: the same moves, in as few blocks as there are rules.

use tch::Device;

use super::*;
use crate::gpu::{GPU, gpu};

#[test]
fn parameters_on_a_gpu_move_as_on_the_processor_in_one_block_for_each_rule() {
    let Some(_gpu) = gpu() else { return };
    let spec = OptimSpec { image_rate_factor: 0.5, ..spec(0.1, 0.5) };
    let moved = |device: Device| {
        let on_device = |(name, x): (String, Tensor)| (name, x.detach().to_device(device).set_requires_grad(true));
        let parameters: Vec<(String, Tensor)> = network().into_iter().map(on_device).collect();
        let mut adam = AdamW::new(parameters.iter().map(|(name, x)| (name.clone(), x.shallow_clone())).collect());
        let norms = (0..6).map(|step| {
            adam.zero_grad();
            let loss: Tensor = parameters.iter().map(|(_, x)| x.pow_tensor_scalar(4).sum(None)).sum();
            loss.backward();
            adam.step(step, 0.01, &spec)
        });
        let norms: Vec<f64> = norms.collect();
        (parameters, norms, adam.blocks.len())
    };
    let (on_cpu, on_gpu) = (moved(Device::Cpu), moved(GPU));
    for ((name, expected), (_, found)) in on_cpu.0.iter().zip(&on_gpu.0) {
        assert_eq!(found.device(), GPU);
        let worst = (expected - found.to_device(Device::Cpu)).abs().max().double_value(&[]);
        assert!(worst < 1e-5, "{name}: {worst}");
    }
    assert!(on_cpu.1.iter().zip(&on_gpu.1).all(|(expected, found)| (expected - found).abs() < 1e-5 * expected));
    assert_eq!((on_cpu.2, on_gpu.2), (5, 4), "on a processor a block ends where it is large");
}
