//! Methods of an experiment: a policy, trained on the experts alone or on gleaned segments too. The paper's have its names.

use gleaner_core::kinds::Family;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

/// The paper's methods with their names in files and in tables.
const PAPER: [(Method, &str, &str); 6] = [
    (Method::BC, "bc", "BC"),
    (Method::TF_BC, "tf_bc", "TF-BC"),
    (Method::SSDF_BASE, "ssdf_base", "SSDF-base"),
    (Method::SSDF, "ssdf", "SSDF"),
    (Method::ACT, "act", "ACT"),
    (Method::SSDF_ACT, "ssdf_act", "SSDF+ACT"),
];
/// Begins the name of a method of another policy that trains on gleaned segments too.
const GLEANED: &str = "gleaned_";

/// A method.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(into = "String")]
pub(crate) struct Method {
    /// The policy that it trains.
    pub(crate) policy: &'static str,
    /// Whether it trains on kept segments beside the experts.
    pub(crate) gleans: bool,
}

impl Method {
    /// Behaviour cloning without history, on the experts.
    pub(crate) const BC: Self = Self { policy: "bc", gleans: false };
    /// The transformer from scratch, on the experts.
    pub(crate) const TF_BC: Self = Self { policy: "tf_bc", gleans: false };
    /// The pretrained transformer, finetuned on the experts alone.
    pub(crate) const SSDF_BASE: Self = Self { policy: "finetune", gleans: false };
    /// The pretrained transformer, finetuned on the experts and the gleaned segments.
    pub(crate) const SSDF: Self = Self { policy: "finetune", gleans: true };
    /// Action chunking with transformers, on the experts.
    pub(crate) const ACT: Self = Self { policy: "act", gleans: false };
    /// The same on the experts and the gleaned segments.
    pub(crate) const SSDF_ACT: Self = Self { policy: "act", gleans: true };

    /// The paper's methods, then each further policy on the experts alone.
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        let paper = PAPER.iter().map(|(method, ..)| *method);
        let named = |name: &str| PAPER.iter().any(|(method, ..)| method.policy == name);
        let further = Family::Policy.kinds().iter().filter(move |kind| !named(&kind.name));
        paper.chain(further.map(|kind| Self { policy: &kind.name, gleans: false }))
    }

    fn of_paper(self) -> Option<(&'static str, &'static str)> {
        PAPER.iter().find(|(method, ..)| *method == self).map(|(_, name, title)| (*name, *title))
    }

    /// As in a file.
    pub(crate) fn name(self) -> String {
        let own = || format!("{}{}", if self.gleans { GLEANED } else { "" }, self.policy);
        self.of_paper().map_or_else(own, |(name, _)| name.to_owned())
    }

    /// As in a table.
    pub(crate) fn title(self) -> String {
        let own = || {
            let title = Family::Policy.find(self.policy).map_or(self.policy, |kind| &kind.title);
            format!("{title}{}", if self.gleans { " + gleaned" } else { "" })
        };
        self.of_paper().map_or_else(own, |(_, title)| title.to_owned())
    }

    /// Whether it needs an encoder, to start from or to score with.
    pub(crate) fn pretrains(self) -> bool {
        self.gleans || Family::Policy.find(self.policy).is_some_and(|kind| kind.needs.encoder)
    }
}

impl Default for Method {
    fn default() -> Self {
        Self::SSDF
    }
}

// By hand: the derived one would borrow the policy's name from the text.
impl<'de> Deserialize<'de> for Method {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::try_from(String::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}

impl TryFrom<String> for Method {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        if let Some((method, ..)) = PAPER.iter().find(|(_, known, _)| *known == name) {
            return Ok(*method);
        }
        let (policy, gleans) = name.strip_prefix(GLEANED).map_or((name.as_str(), false), |policy| (policy, true));
        match Family::Policy.find(policy) {
            Some(kind) => Ok(Self { policy: &kind.name, gleans }),
            None => {
                let known: Vec<String> = Self::all().map(Self::name).collect();
                Err(format!("unknown method {name:?}; supported: {}, and {GLEANED}POLICY", known.join(", ")))
            }
        }
    }
}

impl From<Method> for String {
    fn from(method: Method) -> Self {
        method.name()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_parses_to_the_method_that_wrote_it() {
        for method in Method::all() {
            assert_eq!(Method::try_from(method.name()), Ok(method));
        }
        let gleaned = Method::try_from("gleaned_tf_bc".to_owned()).unwrap();
        assert_eq!((gleaned.policy, gleaned.gleans, gleaned.title().as_str()), ("tf_bc", true, "TF-BC + gleaned"));
        assert_eq!(Method::try_from("gleaned_act".to_owned()).unwrap().name(), "ssdf_act");
        let message = Method::try_from("magic".to_owned()).unwrap_err();
        assert!(message.contains("supported: bc, tf_bc, ssdf_base"), "{message}");
    }

    #[test]
    fn every_policy_is_a_method() {
        for kind in Family::Policy.kinds() {
            assert!(Method::all().any(|method| method.policy == kind.name), "{}", kind.name);
        }
        assert!(Method::default().pretrains());
    }
}
