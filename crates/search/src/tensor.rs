//! Plain arrays to tensors on the CPU and back. Must not depend on the meaning of the values.

use tch::Tensor;

/// `[N, width]` of row-major values.
pub(crate) fn rows(values: &[f32], width: usize) -> Tensor {
    Tensor::from_slice(values).view([-1, int(width)])
}

/// A length in the tensor library's type. Lengths of arrays in memory always fit.
pub(crate) fn int(length: usize) -> i64 {
    i64::try_from(length).unwrap_or(i64::MAX)
}
