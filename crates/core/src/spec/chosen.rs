//! The kind that a job chooses, with its own settings.

use serde::{Deserialize, Serialize};

use super::groups::OptimSpec;
use crate::kinds::{Family, Kind};
use crate::schema::{Problem, Setting, Shape, Values, complete};
use crate::settings::Group;

/// A policy, weighting or scorer by its name, with its complete settings of its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Chosen {
    /// The kind's name.
    pub name: String,
    /// Its own settings, with defaults filled in.
    pub settings: Values,
}

impl Chosen {
    /// The kind of that name with all settings at their defaults.
    ///
    /// # Errors
    /// The family has no such kind.
    pub fn new(family: Family, name: &str) -> Result<Self, Problem> {
        let kind = family.kind(name)?;
        let settings = complete(&own(kind), &Values::new(), |_| None)?;
        Ok(Self { name: kind.name.clone(), settings })
    }

    /// The same kind with one setting changed.
    ///
    /// # Errors
    /// The kind has no such setting, or the value is not allowed.
    pub fn with(mut self, family: Family, name: &str, value: impl Into<serde_json::Value>) -> Result<Self, Problem> {
        self.settings.insert(name.to_owned(), value.into());
        self.settings = complete(&own(family.kind(&self.name)?), &self.settings, |_| None)?;
        Ok(self)
    }

    /// Its settings, typed.
    ///
    /// # Errors
    /// A value that the setting does not allow.
    pub fn read<G: Group>(&self) -> Result<G, Problem> {
        G::read(&self.settings)
    }

    /// The first kind of the family.
    pub(super) fn first(family: Family) -> Self {
        Self::new(family, family.default_name()).unwrap_or(Self { name: String::new(), settings: Values::new() })
    }

    /// Adds the choice and its settings to `values`.
    pub(super) fn write(&self, family: Family, values: &mut Values) {
        values.insert(family.as_str().to_owned(), self.name.clone().into());
        values.extend(self.settings.clone());
    }
}

/// The kind of a family that the settings of a job choose.
pub(super) struct Choice {
    family: Family,
    kind: &'static Kind,
}

impl Choice {
    /// The choice of `values`, or the default.
    pub(super) fn read(family: Family, values: &Values) -> Result<Self, Problem> {
        let choice = choice(family);
        let given = values.get(&choice.name).filter(|given| !given.is_null());
        let name = choice.check(given.unwrap_or(&choice.default))?;
        Ok(Self { family, kind: family.kind(name.as_str().unwrap_or_default())? })
    }

    /// Completes the settings of a job, `common`, and those of the chosen kinds.
    pub(super) fn complete(choices: &[&Self], common: &[Setting], values: &Values) -> Result<Values, Problem> {
        let own = choices.iter().flat_map(|choice| &choice.kind.settings);
        let schema: Vec<Setting> = common.iter().chain(own).cloned().collect();
        complete(&schema, values, |unknown| {
            choices.iter().find_map(|choice| elsewhere(choice.family, unknown, &choice.kind.name))
        })
    }

    /// The chosen kind, with the complete settings of its own.
    pub(super) fn chosen(&self, all: &Values) -> Chosen {
        let own = own(self.kind);
        let own = own.iter().filter_map(|own| all.get_key_value(&own.name));
        Chosen {
            name: self.kind.name.clone(),
            settings: own.map(|(name, value)| (name.clone(), value.clone())).collect(),
        }
    }
}

/// The settings of a kind that are not typed in the spec of its job.
fn own(kind: &Kind) -> Vec<Setting> {
    kind.settings.iter().filter(|setting| !OptimSpec::is_of_policy(&setting.name)).cloned().collect()
}

/// The setting that chooses a kind of a family.
pub(super) fn choice(family: Family) -> Setting {
    let about = match family {
        Family::Policy => "Policy to train.",
        Family::Objective => "Self-supervised objective to train.",
        Family::Weighting => "Weighting of kept imperfect segments in the loss of a policy.",
        Family::Scorer => "Scorer that computes the quality of segments.",
    };
    Setting {
        name: family.as_str().to_owned(),
        about: about.to_owned(),
        shape: Shape::Word { words: family.words() },
        default: family.default_name().into(),
    }
}

/// The error for a setting that another kind has.
fn elsewhere(family: Family, setting: &str, chosen: &str) -> Option<String> {
    let has = |kind: &&Kind| kind.settings.iter().any(|own| own.name == setting);
    let kinds: Vec<&str> = family.kinds().iter().filter(has).map(|kind| kind.name.as_str()).collect();
    if kinds.is_empty() {
        return None;
    }
    let word = family.as_str();
    Some(format!("has no effect: the {word} {chosen} does not use it, only {}; leave it out", kinds.join(", ")))
}
