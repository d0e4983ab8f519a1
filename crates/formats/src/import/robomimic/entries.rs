//! The observations of a demonstration: which are pictures and which are numbers, by their shapes and types alone.

use hdf5_pure::DType;

/// One dataset in `obs`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    pub(super) key: String,
    pub(super) kind: Kind,
}

/// What a dataset holds for each step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// (height, width) of RGB.
    Color(u32, u32),
    /// (height, width) of metres.
    Depth(u32, u32),
    /// A vector of this length.
    Numbers(usize),
    /// What is left out, with the reason.
    Other(&'static str),
}

/// What a dataset with these rows holds; the error is the reason why a dataset with it cannot be read.
pub(super) fn kind(shape: &[u64], dtype: &DType) -> Result<Kind, String> {
    let side = |side: &u64| u32::try_from(*side).unwrap_or(u32::MAX);
    if !is_number(dtype) {
        return Err(format!("it has the type {dtype}, which is not read; remove it"));
    }
    Ok(match (shape, dtype) {
        ([_, height, width, 3], DType::U8) => Kind::Color(side(height), side(width)),
        ([_, height, width, 1], DType::F32) => Kind::Depth(side(height), side(width)),
        ([_], _) => Kind::Numbers(1),
        ([_, size], _) => Kind::Numbers(usize::try_from(*size).unwrap_or(usize::MAX)),
        _ => Kind::Other("its shape is neither that of a vector nor of RGB of 8 bits or depth in metres"),
    })
}

/// Whether a type is a number.
pub(super) fn is_number(dtype: &DType) -> bool {
    use DType::{F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
    matches!(dtype, F32 | F64 | I8 | I16 | I32 | I64 | U8 | U16 | U32 | U64)
}
