//! Arrays packed into blobs: little-endian values in sequence, one entry for each step.

use sqlx::error::BoxDynError;

/// A value of fixed size that can be packed.
pub(super) trait Packed: Sized {
    /// The size of a value in bytes.
    const SIZE: usize;

    fn push_to(&self, bytes: &mut Vec<u8>);
    fn from_bytes(bytes: &[u8]) -> Option<Self>;
}

macro_rules! packed {
    ($($number:ty)*) => {$(
        impl Packed for $number {
            const SIZE: usize = size_of::<$number>();

            fn push_to(&self, bytes: &mut Vec<u8>) {
                bytes.extend_from_slice(&self.to_le_bytes());
            }

            fn from_bytes(bytes: &[u8]) -> Option<Self> {
                bytes.try_into().ok().map(Self::from_le_bytes)
            }
        }
    )*};
}

packed!(f32 f64 u32);

impl Packed for [f32; 3] {
    const SIZE: usize = size_of::<Self>();

    fn push_to(&self, bytes: &mut Vec<u8>) {
        self.iter().for_each(|value| value.push_to(bytes));
    }

    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let values: [[u8; 4]; 3] = bytes.as_chunks().0.try_into().ok()?;
        Some(values.map(f32::from_le_bytes))
    }
}

/// Packs values.
pub(super) fn pack<T: Packed>(values: &[T]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(values.len() * T::SIZE);
    values.iter().for_each(|value| value.push_to(&mut bytes));
    bytes
}

/// The values of a packed column.
pub(super) fn unpack<T: Packed>(bytes: &[u8]) -> Result<Vec<T>, BoxDynError> {
    if !bytes.len().is_multiple_of(T::SIZE) {
        return Err(format!("{} bytes are not a multiple of {}-byte values", bytes.len(), T::SIZE).into());
    }
    Ok(bytes.chunks_exact(T::SIZE).filter_map(T::from_bytes).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_survive_a_round_trip_bit_for_bit() {
        let doubles = [0.0, -0.0, f64::MIN_POSITIVE, -1.0 / 3.0, f64::MAX];
        let back: Vec<f64> = unpack(&pack(&doubles)).unwrap();
        assert_eq!(back.map_bits(), doubles.to_vec().map_bits());
        let counts = [0, 1, u32::MAX];
        assert_eq!(unpack::<u32>(&pack(&counts)).unwrap(), counts);
        let triples = [[0.5, -1.0, f32::MAX], [1.0, 2.0, 3.0]];
        assert_eq!(unpack::<[f32; 3]>(&pack(&triples)).unwrap(), triples);
        assert_eq!(pack(&[1u32]), [1, 0, 0, 0], "little-endian");
        assert!(unpack::<f32>(&[]).unwrap().is_empty());
    }

    #[test]
    fn a_torn_array_is_an_internal_error() {
        let error = unpack::<f32>(&[0; 7]).unwrap_err();
        assert_eq!(error.to_string(), "7 bytes are not a multiple of 4-byte values");
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
