//! ROS 2 messages in CDR, read by their `ros2msg` definitions.
//!
//! Every length is checked against the bytes that are left before anything is reserved for it, and every
//! element takes at least one byte, so a message costs no more than its size.

use super::Value;
use super::ros2msg::{Count, Definitions, FieldDefinition, Kind};

/// Deepest nesting of messages that is followed.
const MAX_DEPTH: usize = 64;

/// Reads messages of one type.
#[derive(Debug)]
pub(crate) struct Decoder {
    name: String,
    definitions: Definitions,
}

impl Decoder {
    /// Parses the schema of the type `name`.
    pub(crate) fn new(name: &str, schema: &[u8]) -> Result<Self, String> {
        let text = std::str::from_utf8(schema)
            .map_err(|error| format!("the schema is not text: {error}"))?;
        Ok(Self {
            name: name.to_owned(),
            definitions: Definitions::parse(name, text)?,
        })
    }

    /// Reads one message.
    pub(crate) fn decode<'a>(&'a self, bytes: &'a [u8]) -> Result<Value<'a>, String> {
        let wrong = |problem: String| format!("the bytes are not a `{}`: {problem}", self.name);
        let big_endian = match bytes {
            [0, 0, _, _, ..] => true,
            [0, 1, _, _, ..] => false,
            [a, b, _, _, ..] => {
                return Err(wrong(format!(
                    "encapsulation {a:02x} {b:02x} is unknown, use plain CDR (00 00 or 00 01)"
                )));
            }
            _ => {
                return Err(wrong(
                    "shorter than the 4-byte encapsulation header".to_owned(),
                ));
            }
        };
        let mut cursor = Cursor {
            bytes: bytes.get(4..).unwrap_or_default(),
            at: 0,
            big_endian,
        };
        self.message(0, &mut cursor, 0).map_err(wrong)
    }

    fn message<'a>(
        &'a self,
        index: usize,
        cursor: &mut Cursor<'a>,
        depth: usize,
    ) -> Result<Value<'a>, String> {
        if depth > MAX_DEPTH {
            return Err(format!("messages are nested more than {MAX_DEPTH} deep"));
        }
        let definition = self
            .definitions
            .messages
            .get(index)
            .ok_or("the type is not defined")?;
        if definition.fields.is_empty() {
            // An empty struct is not allowed in the interface language, so ROS sends one unused byte.
            cursor.take(1)?;
        }
        let mut fields = Vec::with_capacity(definition.fields.len());
        for field in &definition.fields {
            let value = self
                .field(field, cursor, depth)
                .map_err(|problem| prefix(&field.name, &problem))?;
            fields.push((field.name.as_str().into(), value));
        }
        Ok(Value::Message(fields))
    }

    fn field<'a>(
        &'a self,
        field: &FieldDefinition,
        cursor: &mut Cursor<'a>,
        depth: usize,
    ) -> Result<Value<'a>, String> {
        let count = match field.count {
            Count::One => return self.element(field.kind, cursor, depth),
            Count::Fixed(count) => count,
            Count::Counted => cursor.length()?,
        };
        if count > cursor.left() {
            return Err(format!(
                "{count} elements do not fit into the {} bytes that are left",
                cursor.left()
            ));
        }
        match field.kind {
            Kind::U8 => Ok(Value::Bytes(cursor.take(count)?.into())),
            Kind::Text | Kind::WideText | Kind::Message(_) => {
                let mut items = Vec::new();
                for _ in 0..count {
                    items.push(self.element(field.kind, cursor, depth)?);
                }
                Ok(Value::List(items))
            }
            scalar => (0..count)
                .map(|_| cursor.number(scalar))
                .collect::<Result<_, _>>()
                .map(Value::Numbers),
        }
    }

    fn element<'a>(
        &'a self,
        kind: Kind,
        cursor: &mut Cursor<'a>,
        depth: usize,
    ) -> Result<Value<'a>, String> {
        match kind {
            Kind::Text => cursor.text(),
            Kind::WideText => cursor.wide_text(),
            Kind::Message(index) => self.message(index, cursor, depth + 1),
            scalar => cursor.number(scalar).map(Value::Number),
        }
    }
}

/// `a` before a problem that may already begin with a path.
fn prefix(name: &str, problem: &str) -> String {
    if problem.starts_with('`') {
        format!("`{name}`.{problem}")
    } else {
        format!("`{name}`: {problem}")
    }
}

/// A place in the bytes after the encapsulation header, to which alignment is relative.
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl<'a> Cursor<'a> {
    fn left(&self) -> usize {
        self.bytes.len().saturating_sub(self.at)
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let end = self.at.checked_add(count).ok_or("a length overflows")?;
        let taken = self
            .bytes
            .get(self.at..end)
            .ok_or_else(|| format!("{count} bytes are needed but {} are left", self.left()))?;
        self.at = end;
        Ok(taken)
    }

    /// A primitive of N bytes, aligned to N, in little-endian order.
    fn primitive<const N: usize>(&mut self) -> Result<[u8; N], String> {
        self.at = self.at.next_multiple_of(N);
        let mut bytes: [u8; N] = self.take(N)?.try_into().map_err(|_| "a primitive is cut")?;
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn length(&mut self) -> Result<usize, String> {
        usize::try_from(u32::from_le_bytes(self.primitive()?))
            .map_err(|_| "a length overflows".to_owned())
    }

    fn number(&mut self, kind: Kind) -> Result<f64, String> {
        Ok(match kind {
            Kind::Bool => f64::from(u8::from(u8::from_le_bytes(self.primitive()?) != 0)),
            Kind::U8 => f64::from(u8::from_le_bytes(self.primitive()?)),
            Kind::I8 => f64::from(i8::from_le_bytes(self.primitive()?)),
            Kind::U16 => f64::from(u16::from_le_bytes(self.primitive()?)),
            Kind::I16 => f64::from(i16::from_le_bytes(self.primitive()?)),
            Kind::U32 => f64::from(u32::from_le_bytes(self.primitive()?)),
            Kind::I32 => f64::from(i32::from_le_bytes(self.primitive()?)),
            // Beyond 2^53 these round, as any reader into doubles does.
            Kind::U64 => u64::from_le_bytes(self.primitive()?) as f64,
            Kind::I64 => i64::from_le_bytes(self.primitive()?) as f64,
            Kind::F32 => f64::from(f32::from_le_bytes(self.primitive()?)),
            Kind::F64 => f64::from_le_bytes(self.primitive()?),
            Kind::Text | Kind::WideText | Kind::Message(_) => return Err("not a number".to_owned()),
        })
    }

    /// Length with the final zero, then the bytes. Text that is not UTF-8 is kept readable.
    fn text(&mut self) -> Result<Value<'a>, String> {
        let length = self.length()?;
        let bytes = self.take(length)?;
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        Ok(Value::Text(String::from_utf8_lossy(bytes)))
    }

    /// Number of UTF-16 units, then each in four bytes: what ROS's default middleware writes.
    fn wide_text(&mut self) -> Result<Value<'a>, String> {
        let length = self.length()?;
        if length > self.left() / 4 {
            return Err(format!(
                "{length} wide characters do not fit into the {} bytes that are left",
                self.left()
            ));
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use super::*;

    fn decode(schema: &str, bytes: &[u8]) -> Result<String, String> {
        let decoder = Decoder::new("lab_msgs/msg/Top", schema.as_bytes()).unwrap();
        decoder.decode(bytes).map(|value| format!("{value:?}"))
    }

    fn value<'a>(decoder: &'a Decoder, bytes: &'a [u8]) -> Value<'a> {
        decoder.decode(bytes).unwrap()
    }

    #[test]
    fn aligns_to_each_primitive_in_both_byte_orders() {
        let decoder =
            Decoder::new("p/msg/T", b"uint8 a\nint16 b\nfloat64 c\nint8 d\nfloat32 e").unwrap();
        let little = [
            &[0, 1, 0, 0, 7, 0, 0xfe, 0xff, 0, 0, 0, 0][..],
            &1.5f64.to_le_bytes(),
            &[0xff, 0, 0, 0],
            &2.5f32.to_le_bytes(),
        ];
        let big = [
            &[0, 0, 0, 0, 7, 0, 0xff, 0xfe, 0, 0, 0, 0][..],
            &1.5f64.to_be_bytes(),
            &[0xff, 0, 0, 0],
            &2.5f32.to_be_bytes(),
        ];
        for bytes in [little.concat(), big.concat()] {
            let value = value(&decoder, &bytes);
            let numbers = ["a", "b", "c", "d", "e"].map(|name| value.number(name).unwrap());
            assert_eq!(numbers, [7.0, -2.0, 1.5, -1.0, 2.5]);
        }
    }

    #[test]
    fn reads_text_wide_text_and_every_kind_of_array() {
        let decoder = Decoder::new(
            "p/msg/T",
            b"string s\nwstring w\nuint8[] b\nint16[2] f\nstring[] l\nbool[<=3] o",
        )
        .unwrap();
        let bytes = [
            &[0, 1, 0, 0, 3, 0, 0, 0, b'h', b'i', 0, 0][..], // s, padded to 4
            &[1, 0, 0, 0, 0xe9, 0, 0, 0],                    // w = é
            &[3, 0, 0, 0, 9, 8, 7, 0],                       // b, padded to 2
            &[1, 0, 2, 0],                                   // f
            &[1, 0, 0, 0, 2, 0, 0, 0, b'x', 0, 0, 0],        // l, padded to 4
            &[2, 0, 0, 0, 1, 0],                             // o
        ]
        .concat();
        let value = value(&decoder, &bytes);
        assert_eq!((value.text("s"), value.text("w")), (Some("hi"), Some("é")));
        assert_eq!(value.bytes("b"), Some(&[9, 8, 7][..]));
        assert_eq!(value.field("f"), Some(&Value::Numbers(vec![1.0, 2.0])));
        assert_eq!(
            value.field("l"),
            Some(&Value::List(vec![Value::Text("x".into())]))
        );
        assert_eq!(value.field("o"), Some(&Value::Numbers(vec![1.0, 0.0])));
    }

    #[test]
    fn an_empty_message_takes_one_byte() {
        let schema = format!(
            "Nothing n\nuint8 x\n{}\nMSG: lab_msgs/Nothing\nint8 LIMIT=3",
            "=".repeat(80)
        );
        let decoder = Decoder::new("lab_msgs/msg/Top", schema.as_bytes()).unwrap();
        assert_eq!(value(&decoder, &[0, 1, 0, 0, 0, 5]).number("x"), Some(5.0));
    }

    #[test]
    fn refuses_lengths_beyond_the_bytes_without_reserving() {
        assert!(
            decode("float64[] a", &[0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff])
                .unwrap_err()
                .contains("`a`: 4294967295")
        );
        assert!(
            decode("string a", &[0, 1, 0, 0, 9, 0, 0, 0, 1])
                .unwrap_err()
                .contains("9 bytes are needed")
        );
        assert!(
            decode("wstring a", &[0, 1, 0, 0, 9, 0, 0, 0, 1])
                .unwrap_err()
                .contains("wide")
        );
        assert!(
            decode("int8[4000000000] a", &[0, 1, 0, 0, 9])
                .unwrap_err()
                .contains("4000000000")
        );
        assert!(decode("float64 a", &[0, 1, 0, 0, 9]).is_err());
        assert!(
            decode("int8 a", &[0, 1])
                .unwrap_err()
                .contains("encapsulation header")
        );
        assert!(
            decode("int8 a", &[0, 3, 0, 0, 9])
                .unwrap_err()
                .contains("00 03")
        );
    }

    #[test]
    fn a_type_that_holds_itself_ends() {
        let schema = format!("Loop a\n{}\nMSG: lab_msgs/Loop\nLoop again", "=".repeat(80));
        assert!(
            decode(&schema, &[0, 1, 0, 0, 1, 2, 3])
                .unwrap_err()
                .contains("nested")
        );
    }
}
