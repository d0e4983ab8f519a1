//! The kind that a job chooses, with its own settings.

use serde::{Deserialize, Serialize};

use crate::kinds::Family;
use crate::schema::{Problem, Setting, Shape, Values, complete};
use crate::settings::Group;

/// A policy or scorer by its name, with its complete settings of its own.
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
        let settings = complete(&kind.settings, &Values::new(), |_| None)?;
        Ok(Self { name: kind.name.clone(), settings })
    }

    /// The same kind with one setting changed.
    ///
    /// # Errors
    /// The kind has no such setting, or the value is not allowed.
    pub fn with(mut self, family: Family, name: &str, value: impl Into<serde_json::Value>) -> Result<Self, Problem> {
        self.settings.insert(name.to_owned(), value.into());
        self.settings = complete(&family.kind(&self.name)?.settings, &self.settings, |_| None)?;
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

    /// Reads the kind that `values` chooses and its settings, and completes the settings of the job, `common`.
    pub(super) fn from_values(family: Family, common: &[Setting], values: &Values) -> Result<(Self, Values), Problem> {
        let choice = choice(family);
        let given = values.get(&choice.name).filter(|given| !given.is_null());
        let name = choice.check(given.unwrap_or(&choice.default))?;
        let kind = family.kind(name.as_str().unwrap_or_default())?;
        let schema = [common, &kind.settings].concat();
        let mut all = complete(&schema, values, |unknown| elsewhere(family, unknown, &kind.name))?;
        let own: Values = kind.settings.iter().filter_map(|own| all.remove_entry(&own.name)).collect();
        Ok((Self { name: kind.name.clone(), settings: own }, all))
    }

    /// Adds the choice and its settings to `values`.
    pub(super) fn write(&self, family: Family, values: &mut Values) {
        values.insert(family.as_str().to_owned(), self.name.clone().into());
        values.extend(self.settings.clone());
    }
}

/// The setting that chooses a kind of a family.
pub(super) fn choice(family: Family) -> Setting {
    let about = match family {
        Family::Policy => "Policy to train.",
        Family::Objective => "Self-supervised objective to train.",
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
    let (_, kinds) = family.settings().into_iter().find(|(known, _)| known.name == setting)?;
    let word = family.as_str();
    Some(format!("has no effect: the {word} {chosen} does not use it, only {}; leave it out", kinds.join(", ")))
}
