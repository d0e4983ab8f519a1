//! ROS 2 messages in CDR, read by their `ros2msg` definitions.
//!
//! Every length is checked against the bytes that are left before anything is reserved for it, every element takes
//! at least one byte, and the values are counted, so what a message costs follows its size.

mod cursor;

use super::Value;
use super::ros2msg::{Count, Definitions, FieldDefinition, Kind, Scalar};
use cursor::Cursor;

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
        let text = std::str::from_utf8(schema).map_err(|error| format!("the schema is not text: {error}"))?;
        Ok(Self { name: name.to_owned(), definitions: Definitions::parse(name, text)? })
    }

    /// Reads one message.
    pub(crate) fn decode<'a>(&'a self, bytes: &'a [u8]) -> Result<Value<'a>, String> {
        let wrong = |problem: String| format!("the bytes are not a `{}`: {problem}", self.name);
        let big_endian = match bytes {
            [0, 0, _, _, ..] => true,
            [0, 1, _, _, ..] => false,
            [a, b, _, _, ..] => {
                return Err(wrong(format!("encapsulation {a:02x} {b:02x} is unknown, use plain CDR (00 00 or 00 01)")));
            }
            _ => {
                return Err(wrong("shorter than the 4-byte encapsulation header".to_owned()));
            }
        };
        let mut cursor = Cursor::new(bytes.get(4..).unwrap_or_default(), big_endian);
        self.message(0, &mut cursor, 0).map_err(wrong)
    }

    fn message<'a>(&'a self, index: usize, cursor: &mut Cursor<'a>, depth: usize) -> Result<Value<'a>, String> {
        if depth > MAX_DEPTH {
            return Err(format!("messages are nested more than {MAX_DEPTH} deep"));
        }
        let definition = self.definitions.messages.get(index).ok_or("the type is not defined")?;
        if definition.fields.is_empty() {
            // An empty struct is not allowed in the interface language, so ROS sends one unused byte.
            cursor.take(1)?;
        }
        cursor.budget.take(definition.fields.len())?;
        let mut fields = Vec::with_capacity(definition.fields.len());
        for field in &definition.fields {
            let value = self.field(field, cursor, depth).map_err(|problem| prefix(&field.name, &problem))?;
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
            return Err(format!("{count} elements do not fit into the {} bytes that are left", cursor.left()));
        }
        match field.kind {
            Kind::Scalar(Scalar::U8) => Ok(Value::Bytes(cursor.take(count)?.into())),
            Kind::Text | Kind::WideText | Kind::Message(_) => {
                cursor.budget.take(count)?;
                let mut items = Vec::new();
                for _ in 0..count {
                    items.push(self.element(field.kind, cursor, depth)?);
                }
                Ok(Value::List(items))
            }
            Kind::Scalar(scalar) => {
                (0..count).map(|_| cursor.number(scalar)).collect::<Result<_, _>>().map(Value::Numbers)
            }
        }
    }

    fn element<'a>(&'a self, kind: Kind, cursor: &mut Cursor<'a>, depth: usize) -> Result<Value<'a>, String> {
        match kind {
            Kind::Text => cursor.text(),
            Kind::WideText => cursor.wide_text(),
            Kind::Message(index) => self.message(index, cursor, depth + 1),
            Kind::Scalar(scalar) => cursor.number(scalar).map(Value::Number),
        }
    }
}

/// `a` before a problem that may already begin with a path.
fn prefix(name: &str, problem: &str) -> String {
    if problem.starts_with('`') { format!("`{name}`.{problem}") } else { format!("`{name}`: {problem}") }
}

#[cfg(test)]
mod tests;
