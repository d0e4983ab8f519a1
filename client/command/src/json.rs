//! `--json`: any message of the API as a JSON value, by its descriptor.
//!
//! Field names are the API's own (snake_case). Enum values are lower-case words without the enum's prefix,
//! null when unspecified. Times are RFC 3339 in UTC, bytes are base64, 64-bit numbers are numbers. Every field
//! is present: an unset field is null, or empty where it can't be unset. Of a choice (oneof) only the chosen member is
//! present.

use std::sync::LazyLock;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use gleaner_proto::v1;
use prost_reflect::{DescriptorPool, DynamicMessage, EnumDescriptor, Kind, ReflectMessage as _};
use serde_json::{Map, Number, Value};

use crate::failure::{Failure, Result};
use crate::words;

/// A message whose descriptor is known by name.
pub(crate) trait Described: prost::Message {
    const NAME: &'static str;
}

macro_rules! described {
    ($($message:ident),* $(,)?) => {
        $(impl Described for v1::$message {
            const NAME: &'static str = concat!("gleaner.v1.", stringify!($message));
        })*
        #[cfg(test)]
        const NAMES: &[&str] = &[$(<v1::$message as Described>::NAME),*];
    };
}

described! {
    CreateTaskResponse, GetTaskResponse, ListTasksResponse, UpdateTaskResponse, DeleteTaskResponse,
    Episode, InspectionEstimate, GetEpisodeResponse, ListEpisodesResponse, LabelEpisodesResponse, ListLabelsResponse,
    DeleteEpisodesResponse, UndeleteEpisodesResponse,
    CreateSnapshotResponse, GetSnapshotResponse, ListSnapshotsResponse,
    Job, GetJobResponse, ListJobsResponse, CancelJobResponse, SubmitPipelineResponse, WatchJobResponse,
    ListKindsResponse, CreateScheduleResponse, ListSchedulesResponse, PauseScheduleResponse,
    ListScoreRunsResponse, GetEpisodeScoresResponse, GetHistogramResponse, CountKeptResponse,
    ScoreRecordingResponse, ScoreRun,
    CreateDatasetResponse, GetDatasetResponse, ListDatasetsResponse, Segment, ListExportFilesResponse,
    ListPoliciesResponse, RegisterPolicyResponse, DeployResponse, RollBackResponse, ListDeploymentsResponse,
    ListEvaluationsResponse, GetEvaluationResponse, ReportEvaluationResponse,
}

static POOL: LazyLock<std::result::Result<DescriptorPool, prost_reflect::DescriptorError>> =
    LazyLock::new(|| DescriptorPool::decode(gleaner_proto::DESCRIPTORS));

/// A message as a JSON object.
pub(crate) fn value<M: Described>(message: &M) -> Result<Value> {
    let impossible = |what: &dyn std::fmt::Display| Failure::message(format!("{} as JSON: {what}", M::NAME));
    let pool = POOL.as_ref().map_err(|error| impossible(error))?;
    let descriptor = pool.get_message_by_name(M::NAME).ok_or_else(|| impossible(&"it has no descriptor"))?;
    let mut dynamic = DynamicMessage::new(descriptor);
    dynamic.transcode_from(message).map_err(|error| impossible(&error))?;
    Ok(object(&dynamic))
}

fn object(message: &DynamicMessage) -> Value {
    let descriptor = message.descriptor();
    if descriptor.full_name() == "google.protobuf.Timestamp" {
        return time(message);
    }
    if descriptor.full_name() == "google.protobuf.Struct" {
        let settings = message.transcode_to::<prost_types::Struct>().ok();
        return Value::Object(gleaner_core::proto::from_struct(settings));
    }
    let mut fields = Map::new();
    for field in descriptor.fields() {
        let chosen = message.has_field(&field);
        if !chosen && field.containing_oneof().is_some_and(|oneof| !oneof.is_synthetic()) {
            continue;
        }
        let shown = if chosen || !field.supports_presence() {
            plain(&message.get_field(&field), &field.kind())
        } else {
            Value::Null
        };
        fields.insert(field.name().to_owned(), shown);
    }
    Value::Object(fields)
}

fn plain(value: &prost_reflect::Value, kind: &Kind) -> Value {
    use prost_reflect::Value as Wire;
    match value {
        Wire::Bool(flag) => (*flag).into(),
        Wire::I32(number) => (*number).into(),
        Wire::I64(number) => (*number).into(),
        Wire::U32(number) => (*number).into(),
        Wire::U64(number) => (*number).into(),
        Wire::F32(number) => short(*number),
        Wire::F64(number) => (*number).into(),
        Wire::String(text) => text.as_str().into(),
        Wire::Bytes(bytes) => BASE64_STANDARD.encode(bytes).into(),
        Wire::EnumNumber(number) => kind.as_enum().map_or(Value::Null, |known| enum_word(known, *number)),
        Wire::Message(message) => object(message),
        Wire::List(items) => items.iter().map(|item| plain(item, kind)).collect(),
        // The API has no maps.
        Wire::Map(_) => Value::Null,
    }
}

// The shortest decimal that reads back as the same f32: 0.1, not 0.10000000149. Null for values without a JSON form.
fn short(number: f32) -> Value {
    let decimal = number.to_string().parse().ok().and_then(Number::from_f64);
    decimal.map_or(Value::Null, Value::Number)
}

fn enum_word(known: &EnumDescriptor, number: i32) -> Value {
    let zero = known.get_value(0).map(|zero| zero.name().to_owned()).unwrap_or_default();
    let prefix = zero.strip_suffix("UNSPECIFIED").unwrap_or_default();
    match known.get_value(number) {
        Some(_) if number == 0 => Value::Null,
        Some(named) => words::word(named.name(), prefix).into(),
        None => number.into(),
    }
}

fn time(message: &DynamicMessage) -> Value {
    let time = message.transcode_to::<prost_types::Timestamp>().ok();
    words::timestamp(time.as_ref()).map_or(Value::Null, |time| time.to_string().into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_shown_message_has_a_descriptor() {
        let pool = POOL.as_ref().unwrap();
        for name in NAMES {
            assert!(pool.get_message_by_name(name).is_some(), "{name}");
        }
    }

    #[test]
    fn a_job_has_the_field_names_of_the_api_and_shows_every_field() {
        let job = v1::Job {
            id: "job_1".into(),
            kind: v1::JobKind::Score.into(),
            state: v1::JobState::Running.into(),
            done: 1 << 60,
            create_time: Some(prost_types::Timestamp { seconds: 0, nanos: 500_000_000 }),
            spec: Some(v1::JobSpec {
                spec: Some(v1::job_spec::Spec::Score(v1::ScoreSpec {
                    encoder_id: "enc_1".into(),
                    settings: json!({"similarity": "last_l2", "seed": 7})
                        .as_object()
                        .map(gleaner_core::proto::to_struct),
                    ..v1::ScoreSpec::default()
                })),
            }),
            ..v1::Job::default()
        };
        assert_eq!(
            value(&job).unwrap(),
            json!({
                "id": "job_1", "task_id": "", "kind": "score", "state": "running", "priority": 0,
                "spec": {"score": {
                    "encoder_id": "enc_1", "snapshot_id": "", "extends": "",
                    "settings": {"similarity": "last_l2", "seed": 7},
                }},
                "done": 1_u64 << 60, "total": 0, "message": "", "error": "", "result_id": "", "needs": [],
                "attempt": 0, "max_attempts": 0, "create_time": "1970-01-01T00:00:00.5Z",
                "start_time": null, "end_time": null, "peak_memory_bytes": 0, "key": "",
                "engine": "", "engine_id": "", "node": "", "waiting": "", "engine_options": "",
            })
        );
    }

    #[test]
    fn unset_options_are_null_and_floats_are_short() {
        let segment = v1::Segment {
            role: v1::Role::Imperfect.into(),
            weight: 0.1,
            proprioception: vec![f32::NAN, -2.5],
            frames: vec![1, 2, 3],
            ..v1::Segment::default()
        };
        let shown = value(&segment).unwrap();
        assert_eq!(shown["weight"], json!(0.1));
        assert_eq!(shown["proprioception"], json!([null, -2.5]));
        assert_eq!((&shown["role"], &shown["frames"]), (&json!("imperfect"), &json!("AQID")));
        let dataset =
            v1::GetDatasetResponse { dataset: Some(v1::Dataset { kept_segments: Some(0), ..Default::default() }) };
        let shown = value(&dataset).unwrap();
        assert_eq!(shown["dataset"]["kept_segments"], json!(0));
        assert_eq!(shown["dataset"]["expert_segments"], Value::Null);
    }
}
