//! Which settings a cell really uses: its method, policy, weighting and scorer read no others.
//!
//! So two cells that differ only in a setting that neither uses share their stages, and a study that varies such a
//! setting is rejected. Must not depend on a server.

use gleaner_core::kinds::{Family, Kind};
use gleaner_core::order::needs_encoder;
use gleaner_core::schema::Problem;
use gleaner_core::{Setting, schema_of};
use serde_json::Value;

use super::cell::{CellSettings, has};

/// What the chosen policy and weighting, or the chosen scorer, use.
pub(super) struct Used {
    job: &'static str,
    kinds: Vec<&'static Kind>,
}

impl Used {
    /// Whether it uses the setting: one of its job, or its own.
    pub(super) fn uses(&self, name: &str) -> bool {
        let common = schema_of(self.job).into_iter().any(|(setting, kinds)| setting.name == name && kinds.is_empty());
        common && name != "seed" || self.kinds.iter().any(|kind| kind.settings.iter().any(|own| own.name == name))
    }
}

impl CellSettings {
    /// What the policy of its method and its weighting use.
    pub(super) fn training(&self) -> Used {
        let weighting = self.chosen(Family::Weighting).ok();
        Used { job: "train", kinds: Family::Policy.find(self.method.policy).into_iter().chain(weighting).collect() }
    }

    /// What its scorer uses.
    pub(super) fn scorer(&self) -> Result<Used, Problem> {
        Ok(Used { job: "score", kinds: vec![self.chosen(Family::Scorer)?] })
    }

    fn chosen(&self, family: Family) -> Result<&'static Kind, Problem> {
        family.kind(self.settings.get(family.as_str()).and_then(Value::as_str).unwrap_or(family.default_name()))
    }

    /// Whether it needs an encoder, to begin from or to score with.
    pub(super) fn pretrains(&self) -> bool {
        (self.method.pretrains() && !self.oracle) || self.train_spec(0).is_ok_and(|spec| needs_encoder(&spec))
    }

    /// Whether its policy sees steps before the newest one.
    fn sees_history(&self, training: &Used) -> bool {
        let steps = self.train.get("history_steps").or_else(|| self.settings.get("history_steps"));
        let chosen = training.uses("history_steps") && steps.and_then(Value::as_u64).is_some_and(|steps| steps > 0);
        chosen || training.kinds.iter().any(|kind| kind.needs.history)
    }

    /// The same cell without everything that has no effect in it.
    pub(crate) fn used(&self) -> Self {
        let default = Self::default();
        let mut used = self.clone();
        let scorer = self.scorer().ok().filter(|_| self.method.gleans && !self.oracle);
        let training = self.training();
        let pretrains = self.pretrains();
        let sees_history = self.sees_history(&training);
        let hides = self.settings.get("history_dropout").and_then(Value::as_f64) != Some(0.0);
        used.settings.retain(|name, _| {
            (pretrains && has("pretrain", name))
                || scorer.as_ref().is_some_and(|scorer| has("score", name) && scorer.uses(name))
                || (self.evaluate
                    && has("train", name)
                    && training.uses(name)
                    && (self.method.gleans || !of_weighting(name))
                    && (sees_history || name != "history_dropout")
                    && (sees_history && hides || name != "hidden_history"))
        });
        used.hide_history &= sees_history && self.evaluate;
        if !self.method.gleans {
            (used.beta, used.top, used.shape) = (default.beta, default.top, default.shape);
            used.train.retain(|name, _| !of_weighting(name));
        }
        if !self.evaluate {
            (used.train, used.episodes) = (default.train, default.episodes);
        }
        if !pretrains {
            used.pretrain = default.pretrain;
        }
        used
    }

    /// Fails if one of these settings, as a study varies them, has no effect in this cell.
    pub(crate) fn check_varied<'a>(&self, keys: impl Iterator<Item = &'a str>) -> Result<(), String> {
        let values = |cell: &Self| serde_json::to_value(cell).map_err(|error| error.to_string());
        let (given, used) = (values(self)?, values(&self.used())?);
        for key in keys {
            let value = at(&given, key);
            if value != at(&used, key) && value != default_of(key).as_ref() {
                let scorer = match self.settings.get("scorer").and_then(Value::as_str) {
                    Some(scorer) if self.method.gleans => format!(" scored by {scorer}"),
                    _ => String::new(),
                };
                let (method, end) = (self.method.title(), if self.evaluate { "" } else { " without a training" });
                return Err(format!("{key}: has no effect on {method}{scorer}{end}; leave it out of this cell"));
            }
        }
        Ok(())
    }
}

/// Whether a setting of a training weighs kept segments, so that it has no effect without them.
pub(super) fn of_weighting(name: &str) -> bool {
    let own = |kind: &Kind| kind.settings.iter().any(|setting| setting.name == name);
    name == Family::Weighting.as_str() || Family::Weighting.kinds().iter().any(own)
}

/// The default of a job's setting.
fn default_of(name: &str) -> Option<Value> {
    let settings = ["pretrain", "score", "train"].into_iter().flat_map(schema_of);
    settings.map(|(setting, _): (Setting, _)| setting).find(|setting| setting.name == name).map(|found| found.default)
}

// The value under a key with dots.
fn at<'a>(value: &'a Value, key: &str) -> Option<&'a Value> {
    key.split('.').try_fold(value, |value, part| value.get(part))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::experiment::method::Method;

    fn cell(method: &str) -> CellSettings {
        let settings = json!({
            "segment_length": 3, "objectives": ["tr"], "scorer": "ssdf", "similarity": "segment_l2", "feature_scale": "plain",
            "local_scale": false, "scale": [1.0, 2.0, 3.0], "lambda": 0.7, "history_dropout": 0.1, "chunk_length": 3,
        });
        CellSettings {
            method: Method::try_from(method.to_owned()).unwrap(),
            beta: Some(0.5),
            settings: settings.as_object().unwrap().clone(),
            ..CellSettings::default()
        }
    }

    fn names(cell: &CellSettings) -> Vec<&str> {
        cell.settings.keys().map(String::as_str).collect()
    }

    #[test]
    fn a_method_uses_the_settings_of_its_stages() {
        let scoring = ["feature_scale", "history_dropout", "lambda", "local_scale", "objectives", "scale"];
        assert_eq!(names(&cell("ssdf").used()), [&scoring[..], &["scorer", "segment_length", "similarity"]].concat());
        assert_eq!((names(&cell("bc").used()), cell("bc").used().beta), (Vec::new(), None));
        assert_eq!(names(&cell("tf_bc").used()), ["history_dropout", "segment_length"]);
        assert_eq!(names(&cell("ssdf_base").used()), ["history_dropout", "objectives", "segment_length"]);
        // Its scores come from an encoder, its policy has no history.
        let chunks = cell("ssdf_act").used();
        assert!(names(&chunks).contains(&"chunk_length") && !names(&chunks).contains(&"history_dropout"));
        assert!(names(&chunks).contains(&"segment_length"));
    }

    #[test]
    fn a_weighting_has_an_effect_only_where_segments_are_gleaned() {
        let mut uniform = cell("ssdf");
        uniform.settings.insert("weighting".into(), "uniform".into());
        assert!(names(&uniform.used()).contains(&"weighting") && names(&uniform.used()).contains(&"lambda"));
        assert_eq!(uniform.train_spec(0).unwrap().weighting.name, "uniform");
        let text =
            CellSettings { method: cell("bc").method, ..uniform }.check_varied(["weighting"].into_iter()).unwrap_err();
        assert_eq!(text, "weighting: has no effect on BC; leave it out of this cell");
    }

    #[test]
    fn a_scorer_uses_its_own_settings() {
        let scored_by = |scorer: &str| {
            let mut cell = cell("ssdf");
            cell.settings.insert("scorer".into(), scorer.into());
            cell.used()
        };
        assert!(!names(&scored_by("raw")).contains(&"feature_scale") && names(&scored_by("raw")).contains(&"scale"));
        let classifier = scored_by("classifier");
        assert_eq!(names(&classifier), ["history_dropout", "lambda", "objectives", "scorer", "segment_length"]);
    }

    #[test]
    fn an_oracle_needs_no_scores_and_an_encoder_only_for_its_policy() {
        let oracle = |method| CellSettings { oracle: true, ..cell(method) };
        let (alone, finetuned) = (oracle("gleaned_bc"), oracle("ssdf"));
        assert_eq!((alone.pretrains(), names(&alone.used())), (false, vec!["lambda"]));
        assert!(finetuned.pretrains());
        assert_eq!(names(&finetuned.used()), ["history_dropout", "lambda", "objectives", "segment_length"]);
    }

    #[test]
    fn settings_of_a_training_have_no_effect_without_one() {
        let mut scored = CellSettings { evaluate: false, episodes: 7, ..cell("ssdf") };
        scored.train.insert("steps".into(), json!(3));
        for key in ["train.steps", "train", "episodes", "lambda", "history_dropout"] {
            let text = scored.check_varied([key].into_iter()).unwrap_err();
            assert!(
                text.starts_with(&format!("{key}: has no effect on SSDF scored by ssdf without a training")),
                "{text}"
            );
        }
        assert!(scored.check_varied(["similarity", "segment_length", "beta", "method"].into_iter()).is_ok());
        // Those of the weighting have none without gleaned segments, wherever they are named.
        let mut experts = cell("bc");
        experts.train.insert("lambda".into(), json!(0.9));
        assert!(experts.check_varied(["train.lambda"].into_iter()).unwrap_err().contains("no effect on BC"));
        experts.method = Method::SSDF;
        assert!(experts.check_varied(["train.lambda"].into_iter()).is_ok());
    }

    #[test]
    fn a_setting_without_effect_is_named_where_it_varies() {
        let mut raw = cell("ssdf");
        raw.settings.insert("scorer".into(), "raw".into());
        let text = raw.check_varied(["similarity", "feature_scale"].into_iter()).unwrap_err();
        assert_eq!(text, "feature_scale: has no effect on SSDF scored by raw; leave it out of this cell");
        assert!(raw.check_varied(["similarity", "rule.experts"].into_iter()).is_ok());
        let text = cell("bc").check_varied(["segment_length"].into_iter()).unwrap_err();
        assert!(text.starts_with("segment_length: has no effect on BC;"), "{text}");
        let mut pretrained = cell("tf_bc");
        pretrained.pretrain.insert("steps".into(), json!(3));
        assert!(pretrained.check_varied(["pretrain.steps"].into_iter()).is_err());
    }
}
