//! The kinds of each family: policies, weightings, objectives and scorers, with the settings of their own.
//!
//! A kind is written in one file of the learning crate, which cannot be linked by clients. `kinds.json` repeats what
//! its files state (`make kinds` writes it, a test there compares), so that client and server have every kind as data.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use crate::schema::{Problem, Setting, Values, WordAbout, brief};

/// Every kind of every family.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Kinds {
    /// Kinds of policies, the results of training.
    pub policies: Vec<Kind>,
    /// Kinds of weightings, which weigh kept segments in the loss of a policy.
    pub weightings: Vec<Kind>,
    /// Kinds of objectives, whose losses a pretraining adds up.
    pub objectives: Vec<Kind>,
    /// Kinds of scorers, which compute the scores of segments.
    pub scorers: Vec<Kind>,
}

/// One policy, weighting, objective or scorer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Kind {
    /// Its word, such as `tf_bc`.
    pub name: String,
    /// Its name for people, such as `TF-BC`.
    pub title: String,
    /// Description in one sentence.
    pub about: String,
    /// Requirements of the kind.
    #[serde(default, skip_serializing_if = "Needs::is_none")]
    pub needs: Needs,
    /// The settings that it has besides those of its job.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub settings: Vec<Setting>,
}

/// Requirements of a kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Needs {
    /// A pretrained encoder: a policy starts from its weights, a scorer reads its features. Every score run names an
    /// encoder, for the statistics of the steps.
    pub encoder: bool,
    /// Steps before the newest one.
    pub history: bool,
    /// Camera images.
    pub images: bool,
    /// All episodes at once: such scores cannot be extended, nor given for a single recording.
    pub all_episodes: bool,
}

impl Needs {
    fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// A family of kinds, of which a job chooses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// The results of training.
    Policy,
    /// The weights of kept segments in a training.
    Weighting,
    /// Losses that a pretraining adds up.
    Objective,
    /// Scoring methods of segments.
    Scorer,
}

impl Family {
    /// Every family, in the order of lists.
    pub const ALL: [Self; 4] = [Self::Policy, Self::Weighting, Self::Objective, Self::Scorer];

    /// The family's word, which is also the setting that chooses a kind.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Policy => "policy",
            Self::Weighting => "weighting",
            Self::Objective => "objective",
            Self::Scorer => "scorer",
        }
    }

    /// Its kinds; the first is the default.
    #[must_use]
    pub fn kinds(self) -> &'static [Kind] {
        match self {
            Self::Policy => &KINDS.policies,
            Self::Weighting => &KINDS.weightings,
            Self::Objective => &KINDS.objectives,
            Self::Scorer => &KINDS.scorers,
        }
    }

    /// The kind of that name.
    #[must_use]
    pub fn find(self, name: &str) -> Option<&'static Kind> {
        self.kinds().iter().find(|kind| kind.name == name)
    }

    /// The kind of that name.
    ///
    /// # Errors
    /// The family has no kind of that name; the message lists the known ones.
    pub fn kind(self, name: &str) -> Result<&'static Kind, Problem> {
        self.find(name).ok_or_else(|| {
            let known: Vec<&str> = self.kinds().iter().map(|kind| kind.name.as_str()).collect();
            Problem::new(
                self.as_str(),
                format!("unknown value {}; supported: {}", brief(&name.into()), known.join(", ")),
            )
        })
    }

    /// The kind that settings choose: the named one, or else the default; `None` for an unknown name.
    #[must_use]
    pub fn chosen(self, settings: &Values) -> Option<&'static Kind> {
        self.find(settings.get(self.as_str()).and_then(|name| name.as_str()).unwrap_or(self.default_name()))
    }

    /// The name of the default kind.
    #[must_use]
    pub fn default_name(self) -> &'static str {
        self.kinds().first().map_or("", |kind| kind.name.as_str())
    }

    /// Its kinds as words that a setting chooses from.
    #[must_use]
    pub fn words(self) -> Vec<WordAbout> {
        let word = |kind: &Kind| WordAbout { word: kind.name.clone(), about: kind.about.clone() };
        self.kinds().iter().map(word).collect()
    }

    /// Every setting of its kinds, once, with the names of the kinds that it is limited to (empty: all). Its default is
    /// that of the first of them; another one is part of its description.
    #[must_use]
    pub fn settings(self) -> Vec<(Setting, Vec<&'static str>)> {
        let mut all: Vec<(Setting, Vec<&'static str>)> = Vec::new();
        for kind in self.kinds() {
            for setting in &kind.settings {
                match all.iter_mut().find(|(known, _)| known.name == setting.name) {
                    Some((known, kinds)) => {
                        if known.default != setting.default {
                            known.about += &format!(" Default of {}: {}.", kind.name, setting.default);
                        }
                        kinds.push(&kind.name);
                    }
                    None => all.push((setting.clone(), vec![&kind.name])),
                }
            }
        }
        for (_, kinds) in &mut all {
            if kinds.len() == self.kinds().len() {
                kinds.clear();
            }
        }
        all
    }
}

static KINDS: LazyLock<Kinds> = LazyLock::new(|| {
    // A test reads the same text, so the built-in text is valid.
    serde_json::from_str(include_str!("../kinds.json")).unwrap_or_default()
});

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_embedded_kinds_are_readable_and_have_unique_names() {
        let read: Kinds = serde_json::from_str(include_str!("../kinds.json")).unwrap();
        assert_eq!(*KINDS, read);
        for family in Family::ALL {
            let names: Vec<&str> = family.kinds().iter().map(|kind| kind.name.as_str()).collect();
            assert!(!names.is_empty());
            assert!((1..names.len()).all(|at| !names[..at].contains(&names[at])), "{names:?}");
        }
    }

    #[test]
    fn an_unknown_kind_is_rejected_with_the_known_ones() {
        let message = Family::Policy.kind("dagger").unwrap_err().to_string();
        assert!(message.starts_with("policy: unknown value \"dagger\"; supported: bc, "), "{message}");
    }

    #[test]
    fn weightings_share_no_setting_with_trainings_and_policies() {
        let names = |family: Family| family.settings().into_iter().map(|(setting, _)| setting.name).collect::<Vec<_>>();
        let common = crate::TrainSpec::schema().into_iter().map(|setting| setting.name);
        let others = [names(Family::Policy), common.collect()].concat();
        assert!(names(Family::Weighting).iter().all(|name| !others.contains(name)));
    }

    #[test]
    fn kinds_that_share_a_setting_agree_on_all_but_its_default() {
        for family in Family::ALL {
            for (setting, kinds) in family.settings() {
                for kind in family.kinds() {
                    let Some(own) = kind.settings.iter().find(|own| own.name == setting.name) else { continue };
                    assert_eq!(own.shape, setting.shape, "{}: {}", kind.name, setting.name);
                    let other = format!(" Default of {}: {}.", kind.name, own.default);
                    assert!(setting.about.starts_with(&own.about), "{}: {}", kind.name, setting.name);
                    assert_eq!(
                        setting.about.contains(&other),
                        own.default != setting.default,
                        "{kinds:?}: {setting:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_default_of_a_later_kind_is_described() {
        let (similarity, kinds) =
            Family::Scorer.settings().into_iter().find(|(setting, _)| setting.name == "similarity").unwrap();
        assert_eq!((kinds, similarity.default), (vec!["raw", "ssdf"], "segment_l2".into()));
        let about = "Similarity of the features of two segments. Default of ssdf: \"last_l2\".";
        assert_eq!(similarity.about, about);
    }
}
