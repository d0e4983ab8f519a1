//! Which settings a cell really uses: its method, policy and scorer look at no others.
//!
//! So two cells that differ only in a setting that neither uses share their stages, and a study that varies one is
//! told so. Knows no server.

use serde_json::Value;

use super::cell::{CellSettings, Method};
use crate::choice::{PolicyWord, ScorerWord};

impl CellSettings {
    /// The same cell, with everything that has no effect in it as by default.
    pub(crate) fn used(&self) -> Self {
        let default = Self::default();
        let mut used = self.clone();
        if !self.method.gleans() {
            used = Self {
                scorer: default.scorer,
                similarity: default.similarity,
                feature_scale: default.feature_scale,
                yardstick: default.yardstick,
                normaliser: default.normaliser,
                scale: default.scale,
                beta: default.beta,
                top: default.top,
                lambda: default.lambda,
                ..used
            };
        }
        match used.scorer {
            ScorerWord::Ssdf => {}
            ScorerWord::Raw => used.feature_scale = default.feature_scale,
            ScorerWord::Classifier => {
                (used.similarity, used.feature_scale) = (default.similarity, default.feature_scale);
                (used.yardstick, used.scale) = (default.yardstick, default.scale);
            }
        }
        let has_history = matches!(self.method.policy(), PolicyWord::Finetune | PolicyWord::TfBc);
        if !self.method.pretrains() {
            (used.objectives, used.pretrain) = (default.objectives, default.pretrain);
            if !has_history {
                used.segment_length = default.segment_length;
            }
        }
        if !has_history {
            used.history_dropout = default.history_dropout;
        }
        if self.method.policy() != PolicyWord::Act {
            used.act = default.act;
        }
        used
    }

    /// Fails if one of these settings, as a study varies them, has no effect in this cell.
    pub(crate) fn check_varied<'a>(&self, keys: impl Iterator<Item = &'a str>) -> Result<(), String> {
        let values = |cell: &Self| serde_json::to_value(cell).map_err(|error| error.to_string());
        let (given, used) = (values(self)?, values(&self.used())?);
        for key in keys {
            if at(&given, key) != at(&used, key) {
                let scorer =
                    if self.method.gleans() { format!(" scored by {}", word(&given, "scorer")) } else { String::new() };
                let method = self.method.title();
                return Err(format!("{key}: has no effect on {method}{scorer}; leave it out of this cell"));
            }
        }
        Ok(())
    }
}

impl Method {
    /// Whether it needs an encoder, to begin from or to score with.
    pub(crate) fn pretrains(self) -> bool {
        self.policy() == PolicyWord::Finetune || self.gleans()
    }
}

// What a key with dots names.
fn at<'a>(value: &'a Value, key: &str) -> Option<&'a Value> {
    key.split('.').try_fold(value, |value, part| value.get(part))
}

fn word<'a>(value: &'a Value, key: &str) -> &'a str {
    value[key].as_str().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::choice::{FeatureScaleWord, ObjectiveWord, SimilarityWord, YardstickWord};

    fn cell(method: Method) -> CellSettings {
        CellSettings {
            method,
            segment_length: 3,
            objectives: vec![ObjectiveWord::Tr],
            similarity: SimilarityWord::SegmentL2,
            feature_scale: FeatureScaleWord::Plain,
            yardstick: YardstickWord::None,
            scale: Some([1.0, 2.0, 3.0]),
            beta: 0.5,
            lambda: 0.7,
            history_dropout: 0.1,
            ..CellSettings::default()
        }
    }

    #[test]
    fn a_method_uses_what_it_looks_at() {
        assert_eq!(cell(Method::Ssdf).used(), cell(Method::Ssdf));
        let plain = CellSettings { method: Method::Bc, ..CellSettings::default() };
        assert_eq!(cell(Method::Bc).used(), plain);
        let from_scratch = cell(Method::TfBc).used();
        assert_eq!((from_scratch.segment_length, from_scratch.history_dropout, from_scratch.beta), (3, 0.1, 0.9));
        let base = cell(Method::SsdfBase).used();
        assert_eq!((base.objectives, base.lambda), (vec![ObjectiveWord::Tr], 0.1));
        // Its scores come from an encoder, its policy has no history.
        let chunks = cell(Method::SsdfAct).used();
        assert_eq!((chunks.segment_length, chunks.history_dropout, chunks.beta), (3, 0.5, 0.5));
    }

    #[test]
    fn a_scorer_uses_what_it_looks_at() {
        let raw = CellSettings { scorer: ScorerWord::Raw, ..cell(Method::Ssdf) };
        assert_eq!(raw.used(), CellSettings { feature_scale: FeatureScaleWord::Whitened, ..raw.clone() });
        let classifier = CellSettings { scorer: ScorerWord::Classifier, ..cell(Method::Ssdf) }.used();
        let plain = CellSettings::default();
        assert_eq!(
            (classifier.similarity, classifier.feature_scale, classifier.yardstick, classifier.scale),
            (plain.similarity, plain.feature_scale, plain.yardstick, plain.scale)
        );
    }

    #[test]
    fn what_has_no_effect_is_named_where_it_varies() {
        let raw = CellSettings { scorer: ScorerWord::Raw, ..cell(Method::Ssdf) };
        let said = raw.check_varied(["similarity", "feature_scale"].into_iter()).unwrap_err();
        assert_eq!(said, "feature_scale: has no effect on SSDF scored by raw; leave it out of this cell");
        assert!(raw.check_varied(["similarity", "rule.experts"].into_iter()).is_ok());
        let said = cell(Method::Bc).check_varied(["segment_length"].into_iter()).unwrap_err();
        assert!(said.starts_with("segment_length: has no effect on BC;"), "{said}");
        let mut pretrained = cell(Method::TfBc);
        pretrained.pretrain.steps = Some(3);
        assert!(pretrained.check_varied(["pretrain.steps"].into_iter()).is_err());
    }
}
