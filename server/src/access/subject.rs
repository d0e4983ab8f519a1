//! What an rpc was about: the names and ids in its messages, found by the fields' names. Never what was written.

use std::sync::LazyLock;

use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor, MethodDescriptor, Value};

/// Most that are kept of one rpc.
const MOST: usize = 32;
/// Most characters of one.
const LONGEST: usize = 160;
/// How deep messages within messages are looked at: a job's spec is two down.
const DEEPEST: usize = 3;

/// The names and ids in the first request and the first response of an rpc, as `field=value`. The messages may be cut off.
pub(super) fn subjects(path: &str, request: &[u8], response: &[u8]) -> Vec<String> {
    let Some(method) = method(path) else { return Vec::new() };
    let mut found = Vec::new();
    for (descriptor, bytes) in [(method.input(), request), (method.output(), response)] {
        gather(&read(descriptor, bytes), "", DEEPEST, &mut found);
    }
    found
}

fn method(path: &str) -> Option<MethodDescriptor> {
    static POOL: LazyLock<DescriptorPool> =
        LazyLock::new(|| DescriptorPool::decode(gleaner_proto::DESCRIPTORS).unwrap_or_default());
    let (service, method) = path.strip_prefix('/')?.split_once('/')?;
    POOL.get_service_by_name(service)?.methods().find(|known| known.name() == method)
}

/// A message, or what can be read of it before it is cut off.
fn read(descriptor: MessageDescriptor, bytes: &[u8]) -> DynamicMessage {
    use prost::Message as _;
    let mut message = DynamicMessage::new(descriptor);
    // What came before the end, or before what cannot be read, is in it all the same.
    let _ = message.merge(bytes);
    message
}

fn gather(message: &DynamicMessage, prefix: &str, deeper: usize, found: &mut Vec<String>) {
    for (field, value) in message.fields() {
        let name = format!("{prefix}{}", field.name());
        match value {
            Value::Message(inner) if deeper > 0 => gather(inner, &format!("{name}."), deeper - 1, found),
            Value::String(text) if tells(field.name()) => keep(&name, text, found),
            Value::List(texts) if tells(field.name()) => {
                texts.iter().filter_map(Value::as_str).for_each(|text| keep(&name, text, found));
            }
            // Numbers, bytes, and texts that are no names.
            Value::Bool(_)
            | Value::I32(_)
            | Value::I64(_)
            | Value::U32(_)
            | Value::U64(_)
            | Value::F32(_)
            | Value::F64(_)
            | Value::String(_)
            | Value::Bytes(_)
            | Value::EnumNumber(_)
            | Value::Message(_)
            | Value::List(_)
            | Value::Map(_) => {}
        }
        if found.len() >= MOST {
            return;
        }
    }
}

fn keep(name: &str, text: &str, found: &mut Vec<String>) {
    if text.is_empty() || found.len() >= MOST {
        return;
    }
    // As written in a literal: control characters would reach a terminal.
    let shown: String = text.escape_debug().take(LONGEST).collect();
    let subject = format!("{name}={shown}");
    if !found.contains(&subject) {
        found.push(subject);
    }
}

fn tells(field: &str) -> bool {
    matches!(field, "id" | "name" | "task" | "deployment" | "model_name")
        || field.ends_with("_id")
        || field.ends_with("_ids")
}

#[cfg(test)]
mod tests {
    use gleaner_proto::v1;
    use prost::Message as _;

    use super::*;

    #[test]
    fn names_and_ids_of_request_and_response_are_found() {
        let request = v1::SubmitJobRequest {
            task: "pick".into(),
            key: "mine".into(),
            spec: Some(v1::JobSpec {
                spec: Some(v1::job_spec::Spec::Score(v1::ScoreSpec {
                    encoder_id: "enc_1".into(),
                    ..Default::default()
                })),
            }),
            ..Default::default()
        };
        let response = v1::SubmitJobResponse {
            job: Some(v1::Job { id: "job_1".into(), message: "secret".into(), ..Default::default() }),
        };
        let path = "/gleaner.v1.JobService/SubmitJob";
        let found = subjects(path, &request.encode_to_vec(), &response.encode_to_vec());
        assert_eq!(found, ["task=pick", "spec.score.encoder_id=enc_1", "job.id=job_1"]);
    }

    #[test]
    fn what_is_cut_off_tells_what_came_before() {
        let request = v1::WriteUploadRequest { upload_id: "up_1".into(), offset: 0, data: vec![7; 100_000].into() };
        let bytes = request.encode_to_vec();
        assert_eq!(subjects("/gleaner.v1.EpisodeService/WriteUpload", &bytes[..1000], &[]), ["upload_id=up_1"]);
    }

    #[test]
    fn many_long_and_wicked_ones_stay_within_bounds() {
        let ids = (0..500).map(|n| format!("ep_{n}\u{1b}[2J{}", "x".repeat(1000))).collect();
        let request = v1::LabelEpisodesRequest { episode_ids: ids, ..Default::default() };
        let found = subjects("/gleaner.v1.EpisodeService/LabelEpisodes", &request.encode_to_vec(), &[]);
        assert_eq!(found.len(), MOST);
        assert!(found.iter().all(|subject| subject.len() < 200 && !subject.contains('\u{1b}')));
        let garbage: Vec<u8> = (0..=255).collect();
        assert!(subjects("/gleaner.v1.EpisodeService/LabelEpisodes", &garbage, &garbage).len() <= MOST);
        assert!(subjects("/no/such", b"", b"").is_empty());
    }
}
