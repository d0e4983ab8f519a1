//! The bytes of one CDR message: alignment, byte order and checked lengths.

use crate::dialect::Value;
use crate::dialect::budget::Budget;
use crate::dialect::ros2msg::Scalar;

/// A place in the bytes after the encapsulation header, to which alignment is relative.
pub(super) struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
    big_endian: bool,
    /// The budget for the values of the message.
    pub(super) budget: Budget,
}

impl<'a> Cursor<'a> {
    /// At the beginning of a message whose encapsulation header is taken off.
    pub(super) fn new(bytes: &'a [u8], big_endian: bool) -> Self {
        Self { bytes, at: 0, big_endian, budget: Budget::new() }
    }

    pub(super) fn left(&self) -> usize {
        self.bytes.len().saturating_sub(self.at)
    }

    pub(super) fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let end = self.at.checked_add(count).ok_or("a length overflows")?;
        let taken = self
            .bytes
            .get(self.at..end)
            .ok_or_else(|| format!("{count} bytes are needed but {} are left", self.left()))?;
        self.at = end;
        Ok(taken)
    }

    /// A primitive of N bytes, aligned to N, in little-endian order.
    pub(super) fn primitive<const N: usize>(&mut self) -> Result<[u8; N], String> {
        self.at = self.at.next_multiple_of(N);
        let mut bytes: [u8; N] = self.take(N)?.try_into().map_err(|_| "a primitive is cut")?;
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    pub(super) fn length(&mut self) -> Result<usize, String> {
        usize::try_from(u32::from_le_bytes(self.primitive()?)).map_err(|_| "a length overflows".to_owned())
    }

    pub(super) fn number(&mut self, scalar: Scalar) -> Result<f64, String> {
        Ok(match scalar {
            Scalar::Bool => f64::from(u8::from(u8::from_le_bytes(self.primitive()?) != 0)),
            Scalar::U8 => f64::from(u8::from_le_bytes(self.primitive()?)),
            Scalar::I8 => f64::from(i8::from_le_bytes(self.primitive()?)),
            Scalar::U16 => f64::from(u16::from_le_bytes(self.primitive()?)),
            Scalar::I16 => f64::from(i16::from_le_bytes(self.primitive()?)),
            Scalar::U32 => f64::from(u32::from_le_bytes(self.primitive()?)),
            Scalar::I32 => f64::from(i32::from_le_bytes(self.primitive()?)),
            // Beyond 2^53 these round, as any reader into doubles does.
            Scalar::U64 => u64::from_le_bytes(self.primitive()?) as f64,
            Scalar::I64 => i64::from_le_bytes(self.primitive()?) as f64,
            Scalar::F32 => f64::from(f32::from_le_bytes(self.primitive()?)),
            Scalar::F64 => f64::from_le_bytes(self.primitive()?),
        })
    }

    /// Length with the final zero, then the bytes. Text that is not UTF-8 is kept readable. Text without its final zero
    /// is damage: a name with another byte there would be read as another name.
    pub(super) fn text(&mut self) -> Result<Value<'a>, String> {
        let length = self.length()?;
        let bytes = self.take(length)?;
        match bytes {
            [] | [0] => Ok(Value::Text("".into())),
            [text @ .., 0] => Ok(Value::Text(String::from_utf8_lossy(text))),
            _ => Err(format!("a text of {length} bytes does not end with a zero")),
        }
    }

    /// Number of UTF-16 units, then each in four bytes: what ROS's default middleware writes.
    pub(super) fn wide_text(&mut self) -> Result<Value<'a>, String> {
        let length = self.length()?;
        if length > self.left() / 4 {
            return Err(format!("{length} wide characters do not fit into the {} bytes that are left", self.left()));
        }
        let units = (0..length)
            .map(|_| {
                u16::try_from(u32::from_le_bytes(self.primitive()?))
                    .map_err(|_| "a wide character is too large".to_owned())
            })
            .collect::<Result<Vec<u16>, String>>()?;
        Ok(Value::Text(String::from_utf16_lossy(&units).into()))
    }
}
