//! No string that a client sends becomes a path: every text of every rpc tries to lead out of the data folder.

use std::{collections::BTreeSet, path::Path};

use futures::StreamExt as _;
use gleaner_proto::{DESCRIPTORS, Rpc};
use prost::Message as _;
use prost_reflect::{DescriptorPool, DynamicMessage, FieldDescriptor, Kind, MessageDescriptor, Value};

use super::{guarded::Guarded, raw};
use crate::{api::Api, lab, server::TestServer};

const DEEPEST: usize = 4;

/// A message whose every text is `text`. Of what excludes each other, the one that `turn` says.
fn filled(descriptor: &MessageDescriptor, text: &str, turn: usize, deeper: usize) -> DynamicMessage {
    let mut message = DynamicMessage::new(descriptor.clone());
    for field in descriptor.fields() {
        let turned = field.containing_oneof().filter(|oneof| !oneof.is_synthetic()).is_none_or(|oneof| {
            let choices: Vec<FieldDescriptor> = oneof.fields().collect();
            choices[turn % choices.len()] == field
        });
        let value = match field.kind() {
            _ if !turned || field.is_map() => None,
            Kind::String => Some(Value::String(text.to_owned())),
            Kind::Message(inner) if deeper > 0 => Some(Value::Message(filled(&inner, text, turn, deeper - 1))),
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

/// Every file and folder below `folder`, by its path from there.
fn tree(folder: &Path) -> BTreeSet<String> {
    let (mut found, mut folders) = (BTreeSet::new(), vec![folder.to_owned()]);
    while let Some(current) = folders.pop() {
        for entry in std::fs::read_dir(current).unwrap() {
            let path = entry.unwrap().path();
            found.insert(path.strip_prefix(folder).unwrap().to_string_lossy().into_owned());
            if path.is_dir() {
                folders.push(path);
            }
        }
    }
    found
}

#[tokio::test]
async fn no_text_of_any_rpc_leads_out_of_the_data_folder() {
    let server = Guarded::start(
        &["--workers", "0", "--unary-calls-per-second", "100000", "--calls-per-second", "100000"],
        &[("GLEANER_LOG", "warn")],
    )
    .await;
    let admin = server.token("admin", &[]).await;
    let channel = raw::connect(&server).await;
    let outer = server.data_dir().parent().unwrap().to_owned();
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
            for turn in 0..3 {
                let message = filled(&method.input(), text, turn, DEEPEST).encode_to_vec();
                calls.push(raw::call(&channel, rpc.path(), Some(&admin), message));
            }
        }
    }
    assert!(calls.len() > 1000);
    let codes: Vec<_> = futures::stream::iter(calls).buffer_unordered(32).collect().await;
    assert!(codes.iter().filter(|code| **code == tonic::Code::InvalidArgument).count() > 300, "they were read");
    let new: Vec<String> = tree(&outer).difference(&before).cloned().collect();
    assert!(!new.iter().any(|path| path.contains("escaped")), "{new:?}");
    assert!(new.iter().all(|path| path.starts_with("data/")), "{new:?}");
    let folders = ["blobs", "cache", "tmp", "uploads", "rollouts", "gleaner.db", "trash"];
    let strange = new.iter().find(|path| !folders.iter().any(|folder| path.starts_with(&format!("data/{folder}"))));
    assert_eq!(strange, None);
}

/// What is kept under a name that a client chose: a recording's file name, which comes back in exports.
#[tokio::test]
async fn a_recording_named_like_a_path_is_stored_like_any_other() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let outer = server.data_dir().parent().unwrap().join("escaped.mcap");
    let name = format!("../../../..{}", outer.display());
    let recording = lab::Recording { name: name.clone(), ..lab::RECORDINGS[0].clone() };
    let episode = lab::push(&mut api, lab::TASK, &recording).await.unwrap();
    assert_eq!(episode.file_name, name, "a text like any other");
    assert!(!outer.exists() && !tree(server.data_dir()).iter().any(|path| path.contains("escaped")));
}
