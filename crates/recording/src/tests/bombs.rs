//! Small files with large claims: a limit rejects each before memory is reserved.

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::{MessageHeader, op};
use mcap::{Compression, WriteOptions};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

use super::scene::{Scene, numbers_only, read_bytes, read_bytes_within};
use crate::dialect::{ChannelSchema, Decoder};
use crate::testing::arm;
use crate::{Limits, RecordingError};

/// A file with these messages on topics of their own.
fn file(options: WriteOptions, messages: &[(&str, &[u8])]) -> Vec<u8> {
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    for (topic, data) in messages {
        let channel_id = writer.add_channel(0, topic, "json", &BTreeMap::new()).unwrap();
        let header = MessageHeader { channel_id, sequence: 0, log_time: 1, publish_time: 1 };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn refusal(bytes: &[u8], limits: &Limits) -> String {
    let error = read_bytes_within(bytes, &numbers_only(), limits).unwrap_err();
    assert!(matches!(error, RecordingError::TooLarge { .. } | RecordingError::Damaged { .. }), "{error}");
    error.to_string()
}

/// 32 MiB of zeros in a chunk of some kilobytes.
fn bomb(compression: Compression) -> Vec<u8> {
    let bytes = file(WriteOptions::new().compression(Some(compression)), &[("/x", &vec![0; 32 << 20])]);
    assert!(bytes.len() < 1 << 20, "{} bytes are too many for a bomb", bytes.len());
    bytes
}

/// The offset of the first chunk's unpacked size.
fn unpacked_at(bytes: &[u8]) -> usize {
    let mut at = mcap::MAGIC.len();
    while bytes[at] != op::CHUNK {
        at += 9 + usize::try_from(u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap())).unwrap();
    }
    at + 9 + 16
}

#[test]
fn a_chunk_that_unpacks_to_too_much_is_refused() {
    let limits = Limits { chunk_bytes: 1 << 20, ..Limits::default() };
    for compression in [Compression::Zstd, Compression::Lz4] {
        // One large record, and very many small ones.
        let small: Vec<(&str, &[u8])> = vec![("/x", &[0; 4096]); 1 << 10];
        let many = file(WriteOptions::new().compression(Some(compression)).chunk_size(Some(1 << 30)), &small);
        assert!(many.len() < 1 << 18, "{} bytes are too many for a bomb", many.len());
        for bytes in [bomb(compression), many] {
            let message = refusal(&bytes, &limits);
            assert!(message.contains("may unpack to 1048576"), "{compression:?}: {message}");
        }
    }
}

#[test]
fn a_chunk_with_a_wrong_size_uses_only_the_stated_memory() {
    let limits = Limits { chunk_bytes: 1 << 20, ..Limits::default() };
    for compression in [Compression::Zstd, Compression::Lz4] {
        let mut bytes = bomb(compression);
        let at = unpacked_at(&bytes);
        for claim in [0, 100, 1 << 19] {
            bytes[at..at + 8].copy_from_slice(&u64::to_le_bytes(claim));
            refusal(&bytes, &limits);
        }
        for claim in [1 << 42, u64::MAX] {
            bytes[at..at + 8].copy_from_slice(&claim.to_le_bytes());
            let message = refusal(&bytes, &Limits::default());
            assert!(message.contains(&format!("unpacks to {claim} bytes")), "{message}");
        }
    }
}

#[test]
fn records_are_counted_and_measured() {
    let bytes = Scene::steps(20).mcap();
    assert!(read_bytes(&bytes, &numbers_only()).is_ok());
    let message = refusal(&bytes, &Limits { records: 50, ..Limits::default() });
    assert!(message.contains("more than 50 records"), "{message}");
    let message = refusal(&bytes, &Limits { record_bytes: 30, ..Limits::default() });
    assert!(message.contains("may have 30"), "{message}");
    // The zeros of the chunk parse as very many records of kind 0 and length 0.
    let message = refusal(&after_zeros(&bytes), &Limits { records: 10_000, ..Limits::default() });
    assert!(message.contains("more than 10000 records"), "{message}");
}

/// The same file with a chunk of zeros put before its own.
fn after_zeros(bytes: &[u8]) -> Vec<u8> {
    let zeros = vec![0; 9 << 16];
    let mut chunk = Vec::new();
    chunk.extend([0; 16]);
    chunk.extend((zeros.len() as u64).to_le_bytes());
    chunk.extend([0; 4]);
    chunk.extend([0; 4]);
    chunk.extend((zeros.len() as u64).to_le_bytes());
    chunk.extend(&zeros);
    let mut out = mcap::MAGIC.to_vec();
    out.push(op::CHUNK);
    out.extend((chunk.len() as u64).to_le_bytes());
    out.extend(chunk);
    out.extend(&bytes[mcap::MAGIC.len()..]);
    out
}

#[test]
fn channels_and_their_names_are_limited() {
    let topics: Vec<String> = (0..40).map(|at| format!("/topic/{at}")).collect();
    let messages: Vec<(&str, &[u8])> = topics.iter().map(|topic| (topic.as_str(), &b"1"[..])).collect();
    let bytes = file(WriteOptions::new(), &messages);
    let message = refusal(&bytes, &Limits { channels: 39, ..Limits::default() });
    assert!(message.contains("more than 39 channels"), "{message}");
    let long = file(WriteOptions::new(), &[(&"x".repeat(1025), b"1")]);
    assert!(refusal(&long, &Limits::default()).contains("a topic has 1025 bytes and may have 1024"));
    let strange = file(WriteOptions::new(), &[("/a\u{1b}[2J", b"1")]);
    assert!(refusal(&strange, &Limits::default()).contains("a topic has control characters"));
}

#[test]
fn thousands_of_channels_parse_their_schema_once() {
    let mut schema = "int32 a\n".repeat(20_000);
    schema.push_str("no field\n=");
    let mut writer = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let id = writer.add_schema("p/msg/T", "ros2msg", schema.as_bytes()).unwrap();
    for at in 0..4000 {
        let metadata = BTreeMap::from([("n".to_owned(), at.to_string())]);
        writer.add_channel(id, "/joints", "cdr", &metadata).unwrap();
    }
    writer.finish().unwrap();
    let begun = std::time::Instant::now();
    assert!(read_bytes(&writer.into_inner().into_inner(), &numbers_only()).is_err());
    assert!(begun.elapsed().as_secs() < 10, "each channel parsed its schema: {:?}", begun.elapsed());
}

#[test]
fn deep_message_is_a_finding() {
    let mut scene = Scene::steps(5);
    let deep = (0..100).fold(serde_json::json!(1), |inner, _| serde_json::json!([inner]));
    for message in scene.messages.iter_mut().filter(|message| message.0 == "/tool") {
        message.3["deep"] = deep.clone();
    }
    let error = read_bytes(&scene.mcap(), &numbers_only()).unwrap_err().to_string();
    assert!(error.contains("more than 64 levels deep"), "{error}");
    let wide = Limits { json_depth: 120, ..Limits::default() };
    assert!(read_bytes_within(&scene.mcap(), &numbers_only(), &wide).is_ok());
}

#[test]
fn images_over_the_limit_are_refused_before_the_file_is_opened() {
    let limits = Limits { image_pixels: 100, ..Limits::default() };
    let error = read_bytes_within(b"", &arm(), &limits).unwrap_err();
    assert!(error.to_string().contains("cameras[0]: 128 pixels"), "{error}");
}

/// An empty message of two bytes with a thousand default fields.
#[test]
fn defaults_do_not_multiply() {
    let field = |number: i32, name: &str, kind: Type, type_name: Option<&str>, label: Label| FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        r#type: Some(kind.into()),
        type_name: type_name.map(str::to_owned),
        label: Some(label.into()),
        ..FieldDescriptorProto::default()
    };
    let wide = (1..=1000).map(|at| field(at, &format!("f{at}"), Type::Double, None, Label::Optional)).collect();
    let top = vec![field(1, "many", Type::Message, Some(".p.Wide"), Label::Repeated)];
    let message = |name: &str, field| DescriptorProto { name: Some(name.into()), field, ..DescriptorProto::default() };
    let file = FileDescriptorProto {
        name: Some("p.proto".into()),
        package: Some("p".into()),
        syntax: Some("proto3".into()),
        message_type: vec![message("Wide", wide), message("Top", top)],
        ..FileDescriptorProto::default()
    };
    let schema = prost::Message::encode_to_vec(&FileDescriptorSet { file: vec![file] });
    let described =
        ChannelSchema { message_encoding: "protobuf", schema_encoding: "protobuf", name: "p.Top", data: &schema };
    let decoder = Decoder::new(described, &Limits::default()).unwrap();
    assert!(decoder.decode(&[0x0a, 0].repeat(100)).is_ok());
    let problem = decoder.decode(&[0x0a, 0].repeat(100_000)).unwrap_err();
    assert!(problem.contains("more than 2097152 fields"), "{problem}");
}

/// A byte at a depth of sixty levels needs sixty messages.
#[test]
fn depth_does_not_multiply() {
    let mut schema = "M0[] many".to_owned();
    for at in 0..60 {
        schema += &format!(
            "\n{}\nMSG: p/M{at}\n{}",
            "=".repeat(80),
            if at < 59 { format!("M{} m", at + 1) } else { "uint8 b".into() }
        );
    }
    let described = ChannelSchema {
        message_encoding: "cdr",
        schema_encoding: "ros2msg",
        name: "p/msg/Top",
        data: schema.as_bytes(),
    };
    let decoder = Decoder::new(described, &Limits::default()).unwrap();
    let message = |count: u32| [&[0, 1, 0, 0][..], &count.to_le_bytes(), &vec![7; count as usize]].concat();
    assert!(decoder.decode(&message(1000)).is_ok());
    let problem = decoder.decode(&message(1_000_000)).unwrap_err();
    assert!(problem.contains("more than 2097152 fields"), "{problem}");
}
