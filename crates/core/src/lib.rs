//! The values that client, server, worker and learning share: the settings of every kind of job, each defined once with
//! its default, its allowed range and its documentation.
//!
//! A job's settings are data: a flat map from names to JSON values, checked against a schema ([`schema`]). Typed
//! structs ([`settings!`]) are the same settings for code that uses them. Policies, objectives and scorers bring
//! settings of their own; [`kinds`] lists them.
//!
//! Must not depend on tensors, gRPC, SQL or an async runtime.

pub mod access;
pub mod attempt;
pub mod client;
pub mod curation;
pub mod dataset;
pub mod description;
pub mod episode;
pub mod error;
pub mod evaluation;
pub mod id;
pub mod job;
pub mod kinds;
pub mod limit;
pub mod observation;
pub mod order;
pub mod policy;
mod report;
pub mod schedule;
pub mod schema;
pub mod score;
mod secret;
pub mod selection;
pub mod sequence;
mod settings;
pub mod snapshot;
mod spec;
pub mod statistics;
pub mod task;
mod task_spec;
pub mod time;
pub mod work;

#[cfg(feature = "clap")]
pub mod arguments;
#[cfg(feature = "proto")]
pub mod proto;

pub use error::{Error, Result};
pub use report::{Finding, FindingCode, Report, Severity, TopicReport};
pub use schema::{Problem, Setting, Shape, Values};
pub use secret::Secret;
pub use settings::{Group, Word, Words};
pub use spec::{
    Augmentation, Chosen, Device, EvaluateSpec, ModelSpec, NormaliserKind, OptimSpec, Preset, PretrainSpec, RunSpec,
    ScoreSpec, SizeSpec, TrainSpec, jobs, schema_of,
};
pub use task_spec::{Alignment, CameraSource, CameraSpec, FieldSource, FieldSpec, Mapping, TaskSpec};

#[doc(hidden)]
pub mod private {
    //! Items used by the expansion of [`settings!`](crate::settings).
    pub use serde::de::Error;
    pub use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub use crate::settings::{json, take, text};
}
