//! The values that client, server, worker and learning share: the settings of every kind of job, each defined once with
//! its default, its allowed range and its documentation.
//!
//! Settings are data: a flat map from names to JSON values, which a schema checks. Typed structs are the same settings for
//! code that uses them.
//!
//! - [`schema`] defines a setting and checks a map of settings.
//! - [`PretrainSpec`], [`ScoreSpec`], [`TrainSpec`] and [`EvaluateSpec`] are the settings of each kind of job, typed;
//!   [`settings!`] and [`words!`] declare such structs and their choices.
//! - [`kinds`] lists the policies, objectives and scorers with the settings that only they have.
//! - `proto` (feature `proto`) converts settings to the wire; `arguments` (feature `clap`) turns them into options.
//!
//! The crate depends on no tensors, gRPC, SQL or async runtime, and on no other crate of the workspace.
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
    //! Functions and traits in the expansion of [`settings!`](crate::settings).
    pub use serde::de::Error;
    pub use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub use crate::settings::{json, take, text};
}
