//! One cell of an experiment: everything that is set between the recordings and a success rate.
//!
//! Plain settings as they stand in the file; knows no server. What is not given takes the default here, or the
//! server's where there is none here.

use serde::{Deserialize, Serialize};

use crate::choice::{
    FeatureScaleWord, NormaliserWord, ObjectiveWord, PolicyWord, PresetWord, ScorerWord, SimilarityWord, YardstickWord,
};

// The server's evaluations take no higher ones, so that no two seeds share an attempt.
const HIGHEST_SEED: u64 = u32::MAX as u64 - 1;

/// A method by the paper's name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Method {
    /// Behaviour cloning without history, on the experts.
    Bc,
    /// The transformer from scratch, on the experts.
    TfBc,
    /// The pretrained transformer, finetuned on the experts alone.
    SsdfBase,
    /// The pretrained transformer, finetuned on the experts and the gleaned segments.
    #[default]
    Ssdf,
    /// Action chunking with transformers, on the experts.
    Act,
    /// The same on the experts and the gleaned segments.
    SsdfAct,
}

impl Method {
    pub(crate) const ALL: [Self; 6] = [Self::Bc, Self::TfBc, Self::SsdfBase, Self::Ssdf, Self::Act, Self::SsdfAct];

    /// As the paper writes it.
    pub(crate) fn title(self) -> &'static str {
        match self {
            Self::Bc => "BC",
            Self::TfBc => "TF-BC",
            Self::SsdfBase => "SSDF-base",
            Self::Ssdf => "SSDF",
            Self::Act => "ACT",
            Self::SsdfAct => "SSDF+ACT",
        }
    }

    pub(crate) fn policy(self) -> PolicyWord {
        match self {
            Self::Bc => PolicyWord::Bc,
            Self::TfBc => PolicyWord::TfBc,
            Self::SsdfBase | Self::Ssdf => PolicyWord::Finetune,
            Self::Act | Self::SsdfAct => PolicyWord::Act,
        }
    }

    /// Whether it trains on kept segments beside the experts.
    pub(crate) fn gleans(self) -> bool {
        match self {
            Self::Ssdf | Self::SsdfAct => true,
            Self::Bc | Self::TfBc | Self::SsdfBase | Self::Act => false,
        }
    }
}

/// Settings of one cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct CellSettings {
    pub(crate) method: Method,
    /// Which episodes.
    pub(crate) rule: RuleSettings,
    /// Size of the encoder, and of policies from scratch.
    pub(crate) preset: PresetWord,
    /// The paper's l.
    pub(crate) segment_length: u32,
    pub(crate) objectives: Vec<ObjectiveWord>,
    /// Of the pretraining.
    pub(crate) pretrain: OptimSettings,
    pub(crate) scorer: ScorerWord,
    pub(crate) similarity: SimilarityWord,
    pub(crate) feature_scale: FeatureScaleWord,
    pub(crate) yardstick: YardstickWord,
    pub(crate) normaliser: NormaliserWord,
    /// Factors of the distances of image, proprioception and action.
    pub(crate) scale: Option<[f64; 3]>,
    /// Keep segments with q above this.
    pub(crate) beta: f64,
    /// Instead of β: keep so large a part, the best.
    pub(crate) top: Option<f64>,
    /// Of the policy.
    pub(crate) train: OptimSettings,
    /// Weight of the kept segments' loss.
    pub(crate) lambda: f64,
    /// How often a policy with a history is trained without its past.
    pub(crate) history_dropout: f64,
    pub(crate) act: ActSettings,
    /// Of pretraining and training.
    pub(crate) augmentation: AugmentationSettings,
    /// Each runs the whole cell, and evaluates on attempts of its own.
    pub(crate) seeds: Vec<u64>,
    /// Whether to train and evaluate; otherwise the cell stops at its scores.
    pub(crate) evaluate: bool,
    /// Simulated episodes for each seed.
    pub(crate) episodes: u32,
}

impl Default for CellSettings {
    fn default() -> Self {
        Self {
            method: Method::default(),
            rule: RuleSettings::default(),
            preset: PresetWord::Tiny,
            segment_length: 6,
            objectives: vec![ObjectiveWord::Mtp, ObjectiveWord::Tr, ObjectiveWord::Aa],
            pretrain: OptimSettings::default(),
            scorer: ScorerWord::default(),
            similarity: SimilarityWord::default(),
            feature_scale: FeatureScaleWord::default(),
            yardstick: YardstickWord::default(),
            normaliser: NormaliserWord::default(),
            scale: None,
            beta: 0.9,
            top: None,
            train: OptimSettings::default(),
            lambda: 0.1,
            history_dropout: 0.5,
            act: ActSettings::default(),
            augmentation: AugmentationSettings::default(),
            seeds: vec![0, 1, 2],
            evaluate: true,
            episodes: 200,
        }
    }
}

impl CellSettings {
    /// Checks what the server can't: the rest it refuses itself, with the field's name.
    pub(crate) fn check(&self, cohorts: &[&str]) -> Result<(), String> {
        if self.seeds.is_empty() {
            return Err("seeds: give at least one".into());
        }
        if (1..self.seeds.len()).any(|index| self.seeds[..index].contains(&self.seeds[index])) {
            return Err("seeds: each may be given once".into());
        }
        if let Some(seed) = self.seeds.iter().find(|seed| **seed > HIGHEST_SEED) {
            return Err(format!("seeds: {seed} is too high; evaluations take at most {HIGHEST_SEED}"));
        }
        if self.objectives.is_empty() {
            return Err("objectives: give at least one of mtp, tr, aa".into());
        }
        if self.evaluate && self.episodes == 0 {
            return Err("episodes: give at least 1, or evaluate = false".into());
        }
        if !self.evaluate && !self.method.gleans() {
            let method = self.method.title();
            return Err(format!("evaluate: {method} scores nothing, so nothing is left to do; leave it true"));
        }
        if !(0.0..=1.0).contains(&self.beta) {
            return Err(format!("beta: {} is outside [0, 1]", self.beta));
        }
        if let Some(top) = self.top.filter(|top| !(*top > 0.0 && *top <= 1.0)) {
            return Err(format!("top: {top} is outside (0, 1]"));
        }
        match self.rule.cohorts.iter().find(|named| !cohorts.contains(&named.as_str())) {
            Some(unknown) => {
                Err(format!("rule.cohorts: {unknown:?} is not recorded; [data] has {}", cohorts.join(", ")))
            }
            None => Ok(()),
        }
    }
}

/// Which episodes a cell learns from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct RuleSettings {
    /// At most so many experts; 0: all that are recorded.
    pub(crate) experts: u32,
    /// At most so many imperfect episodes for each expert; 0: all.
    pub(crate) imperfect_per_expert: f64,
    /// Imperfect cohorts; none named: all.
    pub(crate) cohorts: Vec<String>,
    /// Which episodes a limit leaves in.
    pub(crate) seed: u64,
}

/// The optimiser; what is not given takes the server's default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct OptimSettings {
    pub(crate) steps: Option<u32>,
    pub(crate) batch: Option<u32>,
    pub(crate) learning_rate: Option<f64>,
    pub(crate) weight_decay: Option<f64>,
    pub(crate) warmup_steps: Option<u32>,
    pub(crate) clip_norm: Option<f64>,
}

/// Of ACT; what is not given takes the server's default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct ActSettings {
    pub(crate) chunk_length: Option<u32>,
    pub(crate) kl_weight: Option<f64>,
    pub(crate) latent_size: Option<u32>,
}

/// Random changes to images.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct AugmentationSettings {
    pub(crate) shift_pixels: u32,
    pub(crate) brightness: f64,
    pub(crate) contrast: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_work_is_named() {
        let said = |change: &dyn Fn(&mut CellSettings)| {
            let mut cell = CellSettings::default();
            change(&mut cell);
            cell.check(&["freeze", "noise"]).unwrap_err()
        };
        assert!(CellSettings::default().check(&["freeze"]).is_ok());
        assert!(said(&|cell| cell.seeds = vec![1, 2, 1]).starts_with("seeds: "));
        assert!(said(&|cell| cell.objectives.clear()).starts_with("objectives: "));
        assert!(said(&|cell| cell.episodes = 0).starts_with("episodes: "));
        assert!(said(&|cell| cell.top = Some(0.0)).starts_with("top: "));
        assert!(said(&|cell| cell.beta = f64::NAN).starts_with("beta: "));
        let unknown = said(&|cell| cell.rule.cohorts = vec!["freese".into()]);
        assert!(unknown.contains("\"freese\"") && unknown.contains("freeze, noise"), "{unknown}");
        let idle = said(&|cell| (cell.method, cell.evaluate) = (Method::Bc, false));
        assert!(idle.starts_with("evaluate: BC"), "{idle}");
    }
}
