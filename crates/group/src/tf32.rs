//! Whether GPUs may multiply f32 matrices, and convolve, in TF32: three digits of the factors, with sums in f32. A switch of
//! the whole process. Independent of what is multiplied.

use tch::TchError;

use crate::bindings;

/// Allows or forbids TF32. libtorch begins with it in convolutions alone.
///
/// # Errors
/// libtorch's own; today's has none.
pub fn allow_tf32(allowed: bool) -> Result<(), TchError> {
    bindings::allow_tf32(allowed).map_err(TchError::Torch)
}

/// Whether both matrices and convolutions may use TF32.
///
/// # Errors
/// As [`allow_tf32`].
pub fn tf32_allowed() -> Result<bool, TchError> {
    bindings::tf32_allowed().map_err(TchError::Torch)
}
