//! No string of a client becomes a path: every text field of every rpc holds paths out of the data folder.

use std::{collections::BTreeSet, path::Path};

use futures::StreamExt as _;
use gleaner_proto::{DESCRIPTORS, Rpc};
use prost::Message as _;
use prost_reflect::{DescriptorPool, DynamicMessage, FieldDescriptor, Kind, MessageDescriptor, Value};

use crate::support::{files, lab, rpc, secure::SecureServer};

const MAX_DEPTH: usize = 4;

/// A message whose every text is `text`; `variant` selects the field of each oneof.
fn filled(descriptor: &MessageDescriptor, text: &str, variant: usize, depth: usize) -> DynamicMessage {
    let mut message = DynamicMessage::new(descriptor.clone());
    for field in descriptor.fields() {
        let selected = field.containing_oneof().filter(|oneof| !oneof.is_synthetic()).is_none_or(|oneof| {
            let choices: Vec<FieldDescriptor> = oneof.fields().collect();
            choices[variant % choices.len()] == field
        });
        let value = match field.kind() {
            _ if !selected || field.is_map() => None,
            Kind::String => Some(Value::String(text.to_owned())),
            Kind::Message(inner) if depth > 0 => Some(Value::Message(filled(&inner, text, variant, depth - 1))),
            Kind::Uint32 => Some(Value::U32(1)),
            Kind::Uint64 => Some(Value::U64(1)),
            Kind::Double => Some(Value::F64(1.0)),
            Kind::Enum(_) => Some(Value::EnumNumber(1)),
            _ => None,
        };
        let value = value.map(|value| if field.is_list() { Value::List(vec![value]) } else { value });
        if let Some(value) = value {
            message.set_field(&field, value);
        }
    }
    message
}

/// Every file and folder below a folder, by its path from there.
fn tree(folder: &Path) -> BTreeSet<String> {
    let paths = files::tree(folder, |_| true).into_iter();
    paths.map(|path| path.strip_prefix(folder).unwrap().to_string_lossy().into_owned()).collect()
}

#[tokio::test]
async fn no_text_of_a_request_becomes_a_path() {
    let server = SecureServer::start(
        &["--workers", "0", "--unary-calls-per-second", "100000", "--calls-per-second", "100000"],
        &[("GLEANER_LOG", "warn")],
    )
    .await;
    let admin = server.token("admin", &[]).await;
    let channel = rpc::connect(&server).await;
    let outer = server.folder().to_owned();
    let before = tree(&outer);
    let absolute = outer.join("escaped").display().to_string();
    let texts =
        ["../escaped", "../../escaped", &absolute, "a/../../escaped", "..\\escaped", "escaped\0", "%2e%2e/escaped"];
    let pool = DescriptorPool::decode(DESCRIPTORS).unwrap();
    let mut calls = Vec::new();
    for rpc in Rpc::ALL {
        let (service, method) = rpc.path()[1..].split_once('/').unwrap();
        let method = pool.get_service_by_name(service).unwrap().methods().find(|known| known.name() == method).unwrap();
        for text in texts {
            for variant in 0..3 {
                let message = filled(&method.input(), text, variant, MAX_DEPTH).encode_to_vec();
                calls.push(rpc::call(&channel, rpc.path(), Some(&admin), message));
            }
        }
    }
    assert!(calls.len() > 1000);
    let codes: Vec<_> = futures::stream::iter(calls).buffer_unordered(32).collect().await;
    assert!(codes.iter().filter(|code| **code == tonic::Code::InvalidArgument).count() > 300, "the fields were read");
    let new: Vec<String> = tree(&outer).difference(&before).cloned().collect();
    assert!(!new.iter().any(|path| path.contains("escaped")), "{new:?}");
    assert!(new.iter().all(|path| path.starts_with("data/")), "{new:?}");
    let folders = ["blobs", "cache", "tmp", "uploads", "rollouts", "gleaner.db", "trash"];
    let unexpected = new.iter().find(|path| !folders.iter().any(|folder| path.starts_with(&format!("data/{folder}"))));
    assert_eq!(unexpected, None);
}

/// The file name of a recording is stored as a text and returned in exports.
#[tokio::test]
async fn recording_named_like_a_path_stays_in_the_data_folder() {
    let (server, mut api) = lab::idle().await;
    let outer = server.data_dir().parent().unwrap().join("escaped.mcap");
    let name = format!("../../../..{}", outer.display());
    let recording = lab::Recording { name: name.clone(), ..lab::RECORDINGS[0].clone() };
    let episode = lab::push(&mut api, lab::TASK, &recording).await.unwrap();
    assert_eq!(episode.file_name, name, "the name is stored as a text");
    assert!(!outer.exists() && !tree(server.data_dir()).iter().any(|path| path.contains("escaped")));
}
