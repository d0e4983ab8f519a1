//! Protobuf messages of any type, read through the descriptors that the file carries.

use std::panic::{AssertUnwindSafe, catch_unwind};

use prost::Message as _;
use prost_reflect::{
    DescriptorPool, DynamicMessage, FieldDescriptor, MessageDescriptor, ReflectMessage as _, Value as Proto,
};
use prost_types::FileDescriptorSet;

use super::{Value, budget::Budget};

/// Reads messages of one type.
#[derive(Debug)]
pub(crate) struct Decoder {
    message: MessageDescriptor,
}

impl Decoder {
    /// Finds the type `name` in a serialized `FileDescriptorSet`.
    pub(crate) fn new(name: &str, descriptors: &[u8]) -> Result<Self, String> {
        let fix = "record with the complete FileDescriptorSet of the type as the schema";
        let set = FileDescriptorSet::decode(descriptors)
            .map_err(|error| format!("the schema is not a FileDescriptorSet ({error}); {fix}"))?;
        let pool = contained(|| pool(set)).unwrap_or_else(|| Err("they are inconsistent".to_owned()));
        let pool = pool.map_err(|error| format!("the schema's descriptors do not fit together ({error}); {fix}"))?;
        let message =
            pool.get_message_by_name(name).ok_or_else(|| format!("the schema does not describe `{name}`; {fix}"))?;
        Ok(Self { message })
    }

    /// Reads one message.
    pub(crate) fn decode(&self, bytes: &[u8]) -> Result<Value<'static>, String> {
        let wrong = |problem: String| format!("the bytes are not a `{}`: {problem}", self.message.full_name());
        let read = || {
            let message = DynamicMessage::decode(self.message.clone(), bytes).map_err(|error| error.to_string())?;
            convert_message(message, &mut Budget::new())
        };
        contained(read).unwrap_or_else(|| Err("they are inconsistent".to_owned())).map_err(wrong)
    }
}

/// The pool includes the well-known types, because some recorders omit them.
fn pool(set: FileDescriptorSet) -> Result<DescriptorPool, String> {
    let mut pool = DescriptorPool::global();
    let files = set.file.into_iter().filter(|file| pool.get_file_by_name(file.name()).is_none()).collect::<Vec<_>>();
    pool.add_file_descriptor_protos(files).map_err(|error| error.to_string())?;
    Ok(pool)
}

/// The reflection crate panics on some hostile descriptors, such as two files of one name; `None` stands for that.
fn contained<T>(work: impl FnOnce() -> T) -> Option<T> {
    catch_unwind(AssertUnwindSafe(work)).ok()
}

fn convert_message(mut message: DynamicMessage, budget: &mut Budget) -> Result<Value<'static>, String> {
    let descriptor = message.descriptor();
    budget.take(descriptor.fields().len())?;
    let mut fields = Vec::new();
    for field in descriptor.fields() {
        if let Some(value) = take(&mut message, &field, budget)? {
            fields.push((field.name().to_owned().into(), value));
        }
    }
    Ok(Value::Message(fields))
}

/// A field's value; its default when it is not on the wire and has one.
fn take(
    message: &mut DynamicMessage,
    field: &FieldDescriptor,
    budget: &mut Budget,
) -> Result<Option<Value<'static>>, String> {
    match message.take_field(field) {
        Some(value) => convert(value, budget),
        None if field.supports_presence() && field.kind().as_message().is_some() => Ok(None),
        None => convert(Proto::default_value_for_field(field), budget),
    }
}

fn convert(value: Proto, budget: &mut Budget) -> Result<Option<Value<'static>>, String> {
    Ok(Some(match value {
        Proto::String(text) => Value::Text(text.into()),
        Proto::Bytes(bytes) => Value::Bytes(Vec::from(bytes).into()),
        Proto::Message(message) => convert_message(message, budget)?,
        Proto::List(items) => convert_list(items, budget)?,
        Proto::Map(_) => return Ok(None),
        scalar @ (Proto::Bool(_)
        | Proto::I32(_)
        | Proto::I64(_)
        | Proto::U32(_)
        | Proto::U64(_)
        | Proto::F32(_)
        | Proto::F64(_)
        | Proto::EnumNumber(_)) => match number(&scalar) {
            Some(number) => Value::Number(number),
            None => return Ok(None),
        },
    }))
}

fn convert_list(items: Vec<Proto>, budget: &mut Budget) -> Result<Value<'static>, String> {
    if let Some(numbers) = items.iter().map(number).collect::<Option<Vec<f64>>>() {
        return Ok(Value::Numbers(numbers));
    }
    budget.take(items.len())?;
    let mut list = Vec::new();
    for item in items {
        list.extend(convert(item, budget)?);
    }
    Ok(Value::List(list))
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
    fn errors_name_the_fault_of_schema_or_bytes() {
        let (name, set) = state_schema();
        assert!(Decoder::new("lab.Other", &set).unwrap_err().contains("`lab.Other`"));
        assert!(Decoder::new(&name, b"no descriptor").unwrap_err().contains("FileDescriptorSet"));
        let decoder = Decoder::new(&name, &set).unwrap();
        assert!(decoder.decode(&[0x0a, 0x7f]).unwrap_err().contains(&name));
    }

    /// Found by fuzzing: the reflection crate panics while it formats its error.
    #[test]
    fn two_files_with_one_name_are_refused() {
        let (name, set) = state_schema();
        let mut set = FileDescriptorSet::decode(set.as_slice()).unwrap();
        let own = set.file.iter().find(|file| DescriptorPool::global().get_file_by_name(file.name()).is_none());
        let twice = own.unwrap().clone();
        set.file.push(twice);
        let problem = Decoder::new(&name, &set.encode_to_vec()).unwrap_err();
        assert!(problem.contains("do not fit together"), "{problem}");
    }
}
