//! numpy arrays in msgpack, as openpi's client packs them: a map of type, shape and bytes.
//!
//! Must not know the meaning of an array.

use gleaner_core::{Error, Result};
use rmpv::Value;

const MARK: &str = "__ndarray__";
const SCALAR: &str = "__npgeneric__";

/// An array that a client sent: its type, its shape, and its values in C order, little-endian.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Array<'a> {
    kind: Kind,
    pub(crate) shape: Vec<usize>,
    pub(crate) data: &'a [u8],
}

/// The types that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    U8,
    U16,
    I32,
    I64,
    F32,
    F64,
}

impl Kind {
    /// The type of numpy's word for it, such as `<f4`.
    fn of(word: &str) -> Option<Self> {
        Some(match word {
            "|u1" => Self::U8,
            "<u2" => Self::U16,
            "<i4" => Self::I32,
            "<i8" => Self::I64,
            "<f4" => Self::F32,
            "<f8" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::I32 | Self::F32 => 4,
            Self::I64 | Self::F64 => 8,
        }
    }
}

impl<'a> Array<'a> {
    /// The array that a map is; `None` for any other value.
    ///
    /// # Errors
    /// Invalid, from `field` on, for an array of another type or of a size that is not its shape's.
    pub(crate) fn of(field: &str, value: &'a Value) -> Result<Option<Self>> {
        let Value::Map(entries) = value else { return Ok(None) };
        if !is_array(entries) {
            return Ok(None);
        }
        let entry = |name: &str| entries.iter().find(|(key, _)| text(key) == Some(name)).map(|(_, value)| value);
        let word = entry("dtype").and_then(text).unwrap_or_default();
        let kind = Kind::of(word).ok_or_else(|| {
            let found: String = word.chars().take(16).collect();
            Error::invalid(
                field,
                format!("has the type {found:?}; send uint8, uint16, int32, int64, float32 or float64"),
            )
        })?;
        let shape = match entry("shape") {
            // A scalar has none.
            None => Vec::new(),
            Some(shape) => shape
                .as_array()
                .and_then(|sizes| {
                    sizes.iter().map(|size| size.as_u64().and_then(|size| usize::try_from(size).ok())).collect()
                })
                .ok_or_else(|| Error::invalid(field, "has a shape that is not a list of sizes"))?,
        };
        let data = entry("data").and_then(Value::as_slice).unwrap_or_default();
        let expected = shape.iter().try_fold(kind.size(), |product, size| product.checked_mul(*size));
        if expected != Some(data.len()) {
            let shown = &shape[..shape.len().min(8)];
            return Err(Error::invalid(
                field,
                format!("has {} bytes, which shape {shown:?} does not have", data.len()),
            ));
        }
        Ok(Some(Self { kind, shape, data }))
    }

    /// Whether its values are bytes, as those of color images.
    pub(crate) fn is_bytes(&self) -> bool {
        self.kind == Kind::U8
    }

    /// Whether its values are 16-bit integers, as those of depth images.
    pub(crate) fn is_words(&self) -> bool {
        self.kind == Kind::U16
    }

    /// Its values as 32-bit numbers, whatever their type.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_precision_loss,
        reason = "policies compute in 32-bit numbers"
    )]
    pub(crate) fn numbers(&self) -> Vec<f32> {
        let data = self.data;
        match self.kind {
            Kind::U8 => data.iter().map(|value| f32::from(*value)).collect(),
            Kind::U16 => each(data, |bytes| f32::from(u16::from_le_bytes(bytes))),
            Kind::I32 => each(data, |bytes| i32::from_le_bytes(bytes) as f32),
            Kind::I64 => each(data, |bytes| i64::from_le_bytes(bytes) as f32),
            Kind::F32 => each(data, f32::from_le_bytes),
            Kind::F64 => each(data, |bytes| f64::from_le_bytes(bytes) as f32),
        }
    }
}

fn each<const N: usize>(data: &[u8], number: impl Fn([u8; N]) -> f32) -> Vec<f32> {
    data.as_chunks::<N>().0.iter().map(|bytes| number(*bytes)).collect()
}

/// Whether a map is an array or a number of numpy rather than a map of names.
pub(crate) fn is_array(entries: &[(Value, Value)]) -> bool {
    entries.iter().any(|(key, _)| text(key).is_some_and(|key| key == MARK || key == SCALAR))
}

/// The text of a key or a word; numpy's packers use byte strings.
pub(crate) fn text(value: &Value) -> Option<&str> {
    value.as_str().or_else(|| std::str::from_utf8(value.as_slice()?).ok())
}

/// An array of 32-bit numbers as openpi's client reads it.
pub(crate) fn numbers(shape: &[usize], values: impl Iterator<Item = f32>) -> Value {
    packed("<f4", shape, values.flat_map(f32::to_le_bytes).collect())
}

/// An array of any type as numpy's packers write it.
pub(crate) fn packed(dtype: &str, shape: &[usize], data: Vec<u8>) -> Value {
    let sizes = shape.iter().map(|size| Value::from(*size)).collect();
    let key = |name: &str| Value::Binary(name.as_bytes().to_vec());
    Value::Map(vec![
        (key(MARK), Value::Boolean(true)),
        (key("data"), Value::Binary(data)),
        (key("dtype"), Value::from(dtype)),
        (key("shape"), Value::Array(sizes)),
    ])
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// An array as the client packs it, of any type.
    pub(crate) fn packed(dtype: &str, shape: &[usize], data: &[u8]) -> Value {
        super::packed(dtype, shape, data.to_vec())
    }

    #[test]
    fn numbers_of_every_type_are_read() {
        let cases: [(&str, &[u8]); 6] = [
            ("|u1", &[3]),
            ("<u2", &[3, 0]),
            ("<i4", &[3, 0, 0, 0]),
            ("<i8", &[3, 0, 0, 0, 0, 0, 0, 0]),
            ("<f4", &3.0_f32.to_le_bytes()),
            ("<f8", &3.0_f64.to_le_bytes()),
        ];
        for (dtype, data) in cases {
            let value = packed(dtype, &[1], data);
            assert_eq!(Array::of("x", &value).unwrap().unwrap().numbers(), [3.0], "{dtype}");
        }
    }

    #[test]
    fn what_is_written_is_read_again() {
        let value = numbers(&[2, 3], (0..6_u8).map(f32::from));
        let array = Array::of("x", &value).unwrap().unwrap();
        assert_eq!((array.shape.as_slice(), array.numbers()), ([2, 3].as_slice(), vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]));
    }

    #[test]
    fn other_values_are_no_arrays_and_broken_arrays_are_named() {
        assert_eq!(Array::of("x", &Value::from(3)).unwrap(), None);
        assert_eq!(Array::of("x", &Value::Map(Vec::new())).unwrap(), None);
        for (value, words) in [
            (packed("|O", &[1], &[1]), "x: has the type \"|O\""),
            (packed(">f4", &[1], &[0; 4]), "x: has the type"),
            (packed("<f4", &[2], &[0; 4]), "x: has 4 bytes"),
            (packed("<f8", &[usize::MAX, 3], &[0; 8]), "x: has 8 bytes"),
            (packed("|u1", &[0, usize::MAX], &[1]), "x: has 1 bytes"),
        ] {
            let error = Array::of("x", &value).unwrap_err();
            assert!(error.message().starts_with(words), "{error}");
        }
    }
}
