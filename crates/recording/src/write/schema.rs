//! The protobuf types that the writer uses, and their descriptors, which go into the file as schemas.
//!
//! The image types are foxglove's, so that its viewer shows them; state and action hold one repeated float
//! for each field of the task.

use prost::Message;
use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor, Value};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, Timestamp};

use gleaner_core::FieldSpec;

const TIMESTAMP_FILE: &str = "google/protobuf/timestamp.proto";

/// foxglove.CompressedImage
#[derive(Clone, PartialEq, Message)]
pub(super) struct CompressedImage {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(bytes = "vec", tag = "2")]
    pub(super) data: Vec<u8>,
    #[prost(string, tag = "3")]
    pub(super) format: String,
    #[prost(string, tag = "4")]
    pub(super) frame_id: String,
}

/// foxglove.CompressedVideo, whose fields are those of an image in another order.
#[derive(Clone, PartialEq, Message)]
pub(super) struct CompressedVideo {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(bytes = "vec", tag = "3")]
    pub(super) data: Vec<u8>,
    #[prost(string, tag = "4")]
    pub(super) format: String,
}

/// foxglove.RawImage
#[derive(Clone, PartialEq, Message)]
pub(super) struct RawImage {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(fixed32, tag = "2")]
    pub(super) width: u32,
    #[prost(fixed32, tag = "3")]
    pub(super) height: u32,
    #[prost(string, tag = "4")]
    pub(super) encoding: String,
    #[prost(fixed32, tag = "5")]
    pub(super) step: u32,
    #[prost(bytes = "vec", tag = "6")]
    pub(super) data: Vec<u8>,
    #[prost(string, tag = "7")]
    pub(super) frame_id: String,
}

/// A message type: its full name and the serialized descriptors that describe it.
pub(crate) struct Schema {
    pub(crate) name: String,
    pub(crate) descriptors: Vec<u8>,
}

/// Descriptors of foxglove.CompressedImage.
pub(super) fn compressed_image() -> Schema {
    let fields = vec![one(2, "data", Type::Bytes), one(3, "format", Type::String), one(4, "frame_id", Type::String)];
    schema("foxglove", "CompressedImage", fields)
}

/// Descriptors of foxglove.CompressedVideo.
pub(super) fn compressed_video() -> Schema {
    let fields = vec![one(2, "frame_id", Type::String), one(3, "data", Type::Bytes), one(4, "format", Type::String)];
    schema("foxglove", "CompressedVideo", fields)
}

/// Descriptors of foxglove.RawImage.
pub(super) fn raw_image() -> Schema {
    let fields = vec![
        one(2, "width", Type::Fixed32),
        one(3, "height", Type::Fixed32),
        one(4, "encoding", Type::String),
        one(5, "step", Type::Fixed32),
        one(6, "data", Type::Bytes),
        one(7, "frame_id", Type::String),
    ];
    schema("foxglove", "RawImage", fields)
}

/// gleaner.Quality: what a score run states of one step, as plain numbers, which viewers draw without a plug-in.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Quality {
    #[prost(message, optional, tag = "1")]
    pub(crate) timestamp: Option<Timestamp>,
    #[prost(uint32, tag = "2")]
    pub(crate) step: u32,
    #[prost(float, tag = "3")]
    pub(crate) q: f32,
    #[prost(double, tag = "4")]
    pub(crate) w: f64,
    #[prost(bool, tag = "5")]
    pub(crate) kept: bool,
    #[prost(string, tag = "6")]
    pub(crate) match_episode: String,
    #[prost(uint32, tag = "7")]
    pub(crate) match_step: u32,
}

/// Descriptors of gleaner.Quality.
pub(crate) fn quality() -> Schema {
    let fields = vec![
        one(2, "step", Type::Uint32),
        one(3, "q", Type::Float),
        one(4, "w", Type::Double),
        one(5, "kept", Type::Bool),
        one(6, "match_episode", Type::String),
        one(7, "match_step", Type::Uint32),
    ];
    schema("gleaner", "Quality", fields)
}

/// Descriptors of gleaner.`name`: the timestamp is 1, the task's fields are 2 and up.
pub(crate) fn numbers(name: &str, specs: &[FieldSpec]) -> Schema {
    let fields = (2..).zip(specs).map(|(number, spec)| FieldDescriptorProto {
        label: Some(Label::Repeated.into()),
        ..one(number, &spec.name, Type::Float)
    });
    schema("gleaner", name, fields.collect())
}

fn schema(package: &str, name: &str, fields: Vec<FieldDescriptorProto>) -> Schema {
    let timestamp = FieldDescriptorProto {
        type_name: Some(".google.protobuf.Timestamp".to_owned()),
        ..one(1, "timestamp", Type::Message)
    };
    let file = FileDescriptorProto {
        name: Some(format!("{package}/{name}.proto")),
        package: Some(package.to_owned()),
        dependency: vec![TIMESTAMP_FILE.to_owned()],
        message_type: vec![DescriptorProto {
            name: Some(name.to_owned()),
            field: std::iter::once(timestamp).chain(fields).collect(),
            ..DescriptorProto::default()
        }],
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    };
    let known = DescriptorPool::global();
    let timestamp_file = known.get_file_by_name(TIMESTAMP_FILE).map(|file| file.file_descriptor_proto().clone());
    let set = FileDescriptorSet { file: timestamp_file.into_iter().chain([file]).collect() };
    Schema { name: format!("{package}.{name}"), descriptors: set.encode_to_vec() }
}

fn one(number: i32, name: &str, kind: Type) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        label: Some(Label::Optional.into()),
        r#type: Some(kind.into()),
        ..FieldDescriptorProto::default()
    }
}

/// A message type that holds the numbers of some fields.
pub(super) struct Numbers {
    message: MessageDescriptor,
    sizes: Vec<usize>,
}

impl Numbers {
    /// The type that [`numbers`] describes.
    pub(super) fn new(schema: &Schema, specs: &[FieldSpec]) -> Option<Self> {
        let message = DescriptorPool::decode(schema.descriptors.as_slice()).ok()?.get_message_by_name(&schema.name)?;
        Some(Self { message, sizes: specs.iter().map(|spec| spec.size as usize).collect() })
    }

    /// The wire form of one message. `values` holds as many as the fields together.
    pub(super) fn encode(&self, timestamp: &Timestamp, values: &[f32]) -> Option<Vec<u8>> {
        let mut message = DynamicMessage::new(self.message.clone());
        let stamp = message.get_field_by_number_mut(1)?;
        if let Value::Message(stamp) = stamp {
            stamp.transcode_from(timestamp).ok()?;
        }
        let mut rest = values;
        for (number, &size) in (2..).zip(&self.sizes) {
            let (field, after) = rest.split_at_checked(size)?;
            let list = field.iter().map(|&value| Value::F32(value)).collect();
            message.try_set_field_by_number(number, Value::List(list)).ok()?;
            rest = after;
        }
        Some(message.encode_to_vec())
    }
}
