//! Arrays packed into blobs: little-endian values in sequence, one entry for each step.

use crate::error::{Error, Result};

/// A value of fixed size that can be packed.
pub(super) trait Packed: Sized {
    /// Its little-endian bytes.
    type Bytes: AsRef<[u8]>;
    /// The size of a value in bytes.
    const SIZE: usize;

    fn to_bytes(&self) -> Self::Bytes;
    fn from_bytes(bytes: &[u8]) -> Option<Self>;
}

macro_rules! packed {
    ($($number:ty)*) => {$(
        impl Packed for $number {
            type Bytes = [u8; size_of::<$number>()];
            const SIZE: usize = size_of::<$number>();

            fn to_bytes(&self) -> Self::Bytes {
                self.to_le_bytes()
            }

            fn from_bytes(bytes: &[u8]) -> Option<Self> {
                bytes.try_into().ok().map(Self::from_le_bytes)
            }
        }
    )*};
}

packed!(f32 f64 u32);

/// Packs values.
pub(super) fn pack<T: Packed>(values: impl IntoIterator<Item = T>) -> Vec<u8> {
    let values = values.into_iter();
    let mut bytes = Vec::with_capacity(values.size_hint().0 * T::SIZE);
    for value in values {
        bytes.extend_from_slice(value.to_bytes().as_ref());
    }
    bytes
}

/// The values of a packed column.
pub(super) fn unpack<T: Packed>(column: &str, bytes: &[u8]) -> Result<impl Iterator<Item = T>> {
    if !bytes.len().is_multiple_of(T::SIZE) {
        return Err(Error::internal(
            format!("reading the column {column}"),
            format!("{} bytes are not a multiple of {}-byte values", bytes.len(), T::SIZE),
        ));
    }
    Ok(bytes.chunks_exact(T::SIZE).filter_map(T::from_bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_survive_a_round_trip_bit_for_bit() {
        let doubles = [0.0, -0.0, f64::MIN_POSITIVE, -1.0 / 3.0, f64::MAX];
        let back: Vec<f64> = unpack("w", &pack(doubles)).unwrap().collect();
        assert_eq!(back.map_bits(), doubles.to_vec().map_bits());
        let counts = [0, 1, u32::MAX];
        assert_eq!(unpack::<u32>("match_step", &pack(counts)).unwrap().collect::<Vec<_>>(), counts);
        assert_eq!(pack([1u32]), [1, 0, 0, 0], "little-endian");
        assert!(unpack::<f32>("q", &[]).unwrap().next().is_none());
    }

    #[test]
    fn a_torn_array_is_an_internal_error() {
        let error = unpack::<f32>("q", &[0; 7]).err().unwrap();
        assert_eq!(error.kind(), crate::error::Kind::Internal);
    }

    trait Bits {
        fn map_bits(self) -> Vec<u64>;
    }

    impl Bits for Vec<f64> {
        fn map_bits(self) -> Vec<u64> {
            self.into_iter().map(f64::to_bits).collect()
        }
    }
}
