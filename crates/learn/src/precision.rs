//! The precision of the large products in a training's passes. Independent of models and of the loop.
//!
//! The tensor library's own switch (autocast) is for CUDA alone and multiplies in f16, whose gradients need scaling.

use std::cell::Cell;

use gleaner_core::Precision;
use tch::{Kind, Tensor};

thread_local! {
    static PRECISION: Cell<Precision> = const { Cell::new(Precision::F32) };
}

/// Restores the precision of the thread, also after a panic.
struct Restore(Precision);

impl Drop for Restore {
    fn drop(&mut self) {
        PRECISION.set(self.0);
    }
}

/// Runs `pass` on this thread with the products of its layers in `precision`. Gradients follow the pass they are of.
pub(crate) fn with<T>(precision: Precision, pass: impl FnOnce() -> T) -> T {
    let _restore = Restore(PRECISION.replace(precision));
    pass()
}

/// The kind of the factors of products, if it is not that of the tensors.
pub(crate) fn reduced() -> Option<Kind> {
    match PRECISION.get() {
        Precision::F32 | Precision::Tf32 => None,
        Precision::Bf16 => Some(Kind::BFloat16),
    }
}

/// `product` of an input, weights and an optional bias, in the precision of this thread's pass. The result has the kind
/// of the input.
pub(crate) fn product(
    (input, weights, bias): (&Tensor, &Tensor, Option<&Tensor>),
    product: impl Fn(&Tensor, &Tensor, Option<&Tensor>) -> Tensor,
) -> Tensor {
    let Some(kind) = reduced() else { return product(input, weights, bias) };
    let bias = bias.map(|bias| bias.to_kind(kind));
    product(&input.to_kind(kind), &weights.to_kind(kind), bias.as_ref()).to_kind(input.kind())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::values;
    use crate::error::guard;

    #[test]
    fn products_alone_are_reduced_and_only_within_the_pass() {
        // 1 + 2^-9 has more digits than bf16, 1.5 and 2 have not.
        let input = Tensor::from_slice(&[1.001_953_1f32, 1.5]).view([1, 2]);
        let weights = Tensor::from_slice(&[2.0f32, 2.0]).view([1, 2]).set_requires_grad(true);
        let sum = || product((&input, &weights, None), |x, w, bias| x.linear(w, bias));
        let exact = values(&sum());
        let found = with(Precision::Bf16, sum);
        assert_eq!((values(&found), found.kind()), (vec![5.0], Kind::Float));
        assert!((exact[0] - 5.003_906).abs() < 1e-6);
        found.sum(None).backward();
        assert_eq!((values(&weights.grad()), weights.grad().kind()), (vec![1.0, 1.5], Kind::Float));
        assert_eq!(values(&sum()), exact);
    }

    #[test]
    fn the_precision_is_restored_after_a_panic_and_is_of_one_thread() {
        let other = with(Precision::Bf16, || std::thread::spawn(reduced).join());
        assert!(matches!(other, Ok(None)));
        let panics = guard(|| with(Precision::Bf16, || -> Result<(), _> { panic!("within the pass") }));
        assert!(panics.is_err() && reduced().is_none());
    }
}
