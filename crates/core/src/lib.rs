//! The values that client, server, worker and learning share, with their rules: ids, tasks, episodes, jobs, scores and
//! selections, the settings of every kind of job, and the one [`Error`].
//!
//! Settings are data: a flat map from names to JSON values, which a schema checks. Typed structs are the same settings
//! for code that uses them.
//!
//! - [`TaskSpec`] is what a step holds and where recordings keep it; [`episode`], [`snapshot`], [`score`], [`selection`]
//!   and [`policy`] are what is stored of it; [`id`] has their ids.
//! - [`job`], [`order`] and [`work`] are what is queued, asked for, and given to a worker.
//! - [`statistics`] and [`ensemble`] compute what the server and its clients must compute alike.
//! - [`schema`] defines a setting and checks a map of settings.
//! - [`PretrainSpec`], [`ScoreSpec`], [`TrainSpec`] and [`EvaluateSpec`] are the settings of each kind of job, typed;
//!   [`settings!`] and [`words!`] declare such structs and their choices.
//! - [`kinds`] lists the policies, weightings, objectives and scorers with the settings that only they have.
//! - `proto` (feature `proto`) converts values to the messages of the API; `arguments` (feature `clap`) turns settings into
//!   options.
//!
//! The crate depends on no tensors, gRPC, SQL, files or async runtime, and on no other crate of the workspace but the
//! messages of the API.
//!
//! ```
//! use gleaner_core::{PretrainSpec, Values};
//! use serde_json::json;
//!
//! let values = |value: serde_json::Value| -> Values { serde_json::from_value(value).unwrap() };
//! let spec = PretrainSpec::from_values(&values(json!({ "steps": 200 }))).unwrap();
//! assert_eq!(spec.values()["steps"], 200);
//!
//! let problem = PretrainSpec::from_values(&values(json!({ "steps": -1 }))).unwrap_err();
//! assert_eq!(problem.field, "steps");
//! ```

pub mod access;
pub mod action;
pub mod attempt;
mod bound;
pub mod client;
pub mod curation;
pub mod dataset;
pub mod description;
pub mod engine_options;
pub mod ensemble;
pub mod episode;
pub mod error;
pub mod evaluation;
pub mod id;
pub mod job;
pub mod kinds;
pub mod limit;
pub mod live;
pub mod looks;
pub mod observation;
pub mod openpi;
pub mod order;
pub mod page;
mod picture_sizes;
pub mod placement;
pub mod policy;
pub mod printable;
mod recording_summary;
pub mod remote;
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
pub mod steps;
mod survey;
pub mod tag;
pub mod task;
mod task_spec;
pub mod time;
pub mod work;

#[cfg(feature = "clap")]
pub mod arguments;
#[cfg(feature = "proto")]
pub mod proto;

pub use bound::Bound;
pub use error::{Error, Result};
pub use picture_sizes::{Crop, PictureSizes, RecordedSize};
pub use recording_summary::{InspectionEstimate, RecordingSummary};
pub use report::{Finding, FindingCode, Report, Severity, TopicReport};
pub use schema::{Problem, Setting, Shape, Values};
pub use secret::Secret;
pub use settings::{Group, Word, Words};
pub use spec::{
    ActionToken, Augmentation, Block, Chosen, Device, EvaluateSpec, FinishedWeights, ImageEncoder, ImageWeights,
    ImageWeightsSpec, InitialWeights, ModelSpec, NormaliserKind, ObserverSpec, OptimSpec, Precision, Preset,
    PretrainSpec, RateSchedule, RunSpec, ScoreSpec, TrainSpec, job_kinds, jobs, schema_of,
};
pub use survey::{FieldKind, Survey, SurveyedCamera, SurveyedField, SurveyedTopic, ValueRange};
pub use task_spec::{
    Alignment, CameraSource, CameraSpec, FieldSource, FieldSpec, Mapping, OpenpiKey, TaskSpec, Transform,
};

#[doc(hidden)]
pub mod private {
    //! Functions and traits in the expansion of [`settings!`](crate::settings).
    pub use serde::de::Error;
    pub use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub use crate::settings::{json, take, text};
}
