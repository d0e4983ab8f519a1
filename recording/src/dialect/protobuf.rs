//! Protobuf messages of any type, read through the descriptors that the file carries.

use prost::Message as _;
use prost_reflect::{
    DescriptorPool, DynamicMessage, FieldDescriptor, MessageDescriptor, ReflectMessage as _, Value as Proto,
};
use prost_types::FileDescriptorSet;

use super::Value;

/// Reads messages of one type.
#[derive(Debug)]
pub(crate) struct Decoder {
    message: MessageDescriptor,
}

impl Decoder {
    /// Finds the type `name` in a serialized `FileDescriptorSet`.
    pub(crate) fn new(name: &str, descriptors: &[u8]) -> Result<Self, String> {
        let mend = "record with the complete FileDescriptorSet of the type as the schema";
        let set = FileDescriptorSet::decode(descriptors)
            .map_err(|error| format!("the schema is not a FileDescriptorSet ({error}); {mend}"))?;
        // The well-known types are at hand, since some recorders leave them out.
        let mut pool = DescriptorPool::global();
        let files =
            set.file.into_iter().filter(|file| pool.get_file_by_name(file.name()).is_none()).collect::<Vec<_>>();
        pool.add_file_descriptor_protos(files)
            .map_err(|error| format!("the schema's descriptors don't fit together ({error}); {mend}"))?;
        let message =
            pool.get_message_by_name(name).ok_or_else(|| format!("the schema does not describe `{name}`; {mend}"))?;
        Ok(Self { message })
    }

    /// Reads one message.
    pub(crate) fn decode(&self, bytes: &[u8]) -> Result<Value<'static>, String> {
        DynamicMessage::decode(self.message.clone(), bytes)
            .map(convert_message)
            .map_err(|error| format!("the bytes are not a `{}`: {error}", self.message.full_name()))
    }
}

fn convert_message(mut message: DynamicMessage) -> Value<'static> {
    let descriptor = message.descriptor();
    let fields = descriptor.fields().filter_map(|field| {
        let value = take(&mut message, &field)?;
        Some((field.name().to_owned().into(), value))
    });
    Value::Message(fields.collect())
}

/// A field's value; its default when it is not on the wire and has one.
fn take(message: &mut DynamicMessage, field: &FieldDescriptor) -> Option<Value<'static>> {
    match message.take_field(field) {
        Some(value) => convert(value),
        None if field.supports_presence() && field.kind().as_message().is_some() => None,
        None => convert(Proto::default_value_for_field(field)),
    }
}

fn convert(value: Proto) -> Option<Value<'static>> {
    Some(match value {
        Proto::String(text) => Value::Text(text.into()),
        Proto::Bytes(bytes) => Value::Bytes(Vec::from(bytes).into()),
        Proto::Message(message) => convert_message(message),
        Proto::List(items) => convert_list(items),
        Proto::Map(_) => return None,
        scalar @ (Proto::Bool(_)
        | Proto::I32(_)
        | Proto::I64(_)
        | Proto::U32(_)
        | Proto::U64(_)
        | Proto::F32(_)
        | Proto::F64(_)
        | Proto::EnumNumber(_)) => Value::Number(number(&scalar)?),
    })
}

fn convert_list(items: Vec<Proto>) -> Value<'static> {
    match items.iter().map(number).collect::<Option<Vec<f64>>>() {
        Some(numbers) => Value::Numbers(numbers),
        None => Value::List(items.into_iter().filter_map(convert).collect()),
    }
}

fn number(value: &Proto) -> Option<f64> {
    match value {
        Proto::Bool(flag) => Some(f64::from(u8::from(*flag))),
        Proto::I32(number) | Proto::EnumNumber(number) => Some(f64::from(*number)),
        Proto::U32(number) => Some(f64::from(*number)),
        // Beyond 2^53 these round, as any reader into doubles does.
        Proto::I64(number) => Some(*number as f64),
        Proto::U64(number) => Some(*number as f64),
        Proto::F32(number) => Some(f64::from(*number)),
        Proto::F64(number) => Some(*number),
        Proto::String(_) | Proto::Bytes(_) | Proto::Message(_) | Proto::List(_) | Proto::Map(_) => None,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use super::*;
    use crate::write::tests::state_schema;

    #[test]
    fn reads_any_described_message_with_its_defaults() {
        let (name, set) = state_schema();
        let decoder = Decoder::new(&name, &set).unwrap();
        // timestamp { seconds: 1 } and joint_position: [1.5] packed.
        let bytes = [0x0a, 0x02, 0x08, 0x01, 0x12, 0x04, 0x00, 0x00, 0xc0, 0x3f];
        let value = decoder.decode(&bytes).unwrap();
        assert_eq!(value.stamp(), Some(1_000_000_000));
        assert_eq!(value.field("joint_position"), Some(&Value::Numbers(vec![1.5])));
        assert_eq!(value.field("tool"), Some(&Value::Numbers(vec![])));
        assert_eq!(decoder.decode(&[]).unwrap().field("timestamp"), None);
    }

    #[test]
    fn names_what_is_wrong_with_schema_or_bytes() {
        let (name, set) = state_schema();
        assert!(Decoder::new("lab.Other", &set).unwrap_err().contains("`lab.Other`"));
        assert!(Decoder::new(&name, b"no descriptor").unwrap_err().contains("FileDescriptorSet"));
        let decoder = Decoder::new(&name, &set).unwrap();
        assert!(decoder.decode(&[0x0a, 0x7f]).unwrap_err().contains(&name));
    }
}
