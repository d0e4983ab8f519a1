//! The settings of each kind of job, typed. Each is a flat map of settings in its stored form.

mod chosen;
mod evaluate;
mod groups;
mod image_weights;
mod pretrain;
mod score;
mod stored;
mod train;

pub use chosen::Chosen;
pub use evaluate::{Block, EvaluateSpec};
pub use groups::{
    ActionToken, Augmentation, Device, FinishedWeights, ImageEncoder, InitialWeights, ModelSpec, ObserverSpec,
    OptimSpec, Precision, Preset, RateSchedule, RunSpec,
};
pub use image_weights::{ImageWeights, ImageWeightsSpec};
pub use pretrain::PretrainSpec;
pub use score::{NormaliserKind, ScoreSpec};
pub use train::TrainSpec;

use std::collections::BTreeMap;

use crate::kinds::{Family, Kind, Needs};
use crate::schema::Setting;

/// Every setting that a kind of job may have, with the names of the policies, weightings or scorers it is limited to
/// (empty: all). `job` is `pretrain`, `score`, `train` or `evaluate`; another job has no settings.
#[must_use]
pub fn schema_of(job: &str) -> Vec<(Setting, Vec<&'static str>)> {
    let common = |settings: Vec<Setting>| settings.into_iter().map(|setting| (setting, Vec::new()));
    match job {
        "pretrain" => common(PretrainSpec::schema()).collect(),
        "score" => common(ScoreSpec::schema()).chain(Family::Scorer.settings()).collect(),
        "train" => {
            let own = Family::Policy.settings().into_iter().chain(Family::Weighting.settings());
            common(TrainSpec::schema()).chain(own).collect()
        }
        "evaluate" => common(EvaluateSpec::schema()).collect(),
        _ => Vec::new(),
    }
}

/// The settings that every job of a kind has, by kind. Choices of policies, weightings, objectives and scorers have no
/// words here: [`crate::kinds`] lists those.
#[must_use]
pub fn jobs() -> BTreeMap<&'static str, Vec<Setting>> {
    let listed = ["policy", "weighting", "objectives", "scorer"];
    let without =
        |settings: Vec<Setting>| settings.into_iter().filter(|setting| !listed.contains(&setting.name.as_str()));
    let job = |settings: Vec<Setting>| without(settings).collect();
    BTreeMap::from([
        ("pretrain", job(PretrainSpec::schema())),
        ("score", job(ScoreSpec::schema())),
        ("train", job(TrainSpec::schema())),
        ("evaluate", job(EvaluateSpec::schema())),
    ])
}

/// The kinds of jobs that have settings, in the order of their use.
#[must_use]
pub fn job_kinds() -> Vec<Kind> {
    let job = |name: &str, about: &str, settings: Vec<Setting>| Kind {
        name: name.to_owned(),
        title: name.to_owned(),
        about: about.to_owned(),
        needs: Needs::default(),
        settings,
    };
    vec![
        job(
            "pretrain",
            "Pretrains an encoder without labels, on experts and imperfect episodes.",
            PretrainSpec::schema(),
        ),
        job("score", "Scores every imperfect segment of a snapshot: a score run.", ScoreSpec::schema()),
        job("train", "Trains a policy by weighted behaviour cloning.", TrainSpec::schema()),
        job("evaluate", "Evaluates a policy in closed-loop trials in the embedded simulator.", EvaluateSpec::schema()),
    ]
}

/// Serialises a spec as its flat map, and reads that map or the form that earlier versions stored.
macro_rules! stored_as_values {
    ($name:ident, $stored:expr) => {
        impl serde::Serialize for $name {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                self.values().serialize(serializer)
            }
        }

        impl<'de> serde::Deserialize<'de> for $name {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let values = <crate::Values as serde::Deserialize>::deserialize(deserializer)?;
                Self::from_values(&$stored(values)).map_err(serde::de::Error::custom)
            }
        }
    };
}
use stored_as_values;

#[cfg(test)]
mod tests;
