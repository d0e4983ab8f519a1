//! The values that client, server, worker and learning share: the settings of every kind of job, each defined once with
//! its default, its allowed range and its documentation.
//!
//! A job's settings are data: a flat map from names to JSON values, checked against a schema ([`schema`]). Typed
//! structs ([`settings!`]) are the same settings for code that uses them. Policies, objectives and scorers bring
//! settings of their own; [`kinds`] lists them. [`ensemble`] makes one action of overlapping chunks, on the server and on
//! robots.
//!
//! Must not depend on tensors, gRPC, SQL or an async runtime.

pub mod ensemble;
pub mod kinds;
pub mod schema;
mod settings;
mod spec;

#[cfg(feature = "clap")]
pub mod arguments;
#[cfg(feature = "proto")]
pub mod proto;

pub use schema::{Problem, Setting, Shape, Values};
pub use settings::{Group, Word, Words};
pub use spec::{
    Augmentation, Chosen, Device, EvaluateSpec, ModelSpec, NormaliserKind, OptimSpec, Preset, PretrainSpec, RunSpec,
    ScoreSpec, SizeSpec, TrainSpec, jobs, schema_of,
};

#[doc(hidden)]
pub mod private {
    //! What [`settings!`](crate::settings) expands to.
    pub use serde::de::Error;
    pub use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub use crate::settings::{json, take, text};
}
