//! One cell of an experiment: everything that is set between the recordings and a success rate.
//!
//! Settings of jobs are data, as on the wire: what is left out takes its default. Must not depend on a server.

use gleaner_core::schema::Problem;
use gleaner_core::selection::{Rule, Selection, SelectionShape};
use gleaner_core::{PretrainSpec, ScoreSpec, TrainSpec, Values, schema_of};
use serde::{Deserialize, Serialize};

use super::method::Method;

// The server rejects higher ones in evaluations, so that no two seeds share an attempt.
const HIGHEST_SEED: u64 = u32::MAX as u64 - 1;
/// Settings that an experiment sets itself.
const OWN: [&str; 4] = ["seed", "device", "policy", "checkpoint_every"];

/// Settings of one cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct CellSettings {
    pub(crate) method: Method,
    /// Which episodes.
    pub(crate) rule: RuleSettings,
    /// Settings of the pretraining alone.
    pub(crate) pretrain: Values,
    /// Settings of the training alone.
    pub(crate) train: Values,
    /// Keep segments with q above this.
    pub(crate) beta: Option<f64>,
    /// Instead of β: keep this part of the segments, the best.
    pub(crate) top: Option<f64>,
    /// The shape of what is kept; settings that are left out have no effect.
    pub(crate) shape: Values,
    /// Each runs the whole cell, and evaluates on attempts of its own.
    pub(crate) seeds: Vec<u64>,
    /// Whether the marks of the recordings take the place of scores: q is 1 for a good segment and 0 for a bad one, the
    /// most that scores can be.
    pub(crate) oracle: bool,
    /// Whether to train and evaluate; otherwise the cell stops at its scores.
    pub(crate) evaluate: bool,
    /// Simulated episodes for each seed.
    pub(crate) episodes: u32,
    /// Whether the policy acts without its history.
    pub(crate) hide_history: bool,
    /// Settings of every job that has them: of pretraining, scoring and training.
    #[serde(flatten)]
    pub(crate) settings: Values,
}

impl Default for CellSettings {
    fn default() -> Self {
        Self {
            method: Method::default(),
            rule: RuleSettings::default(),
            pretrain: Values::new(),
            train: Values::new(),
            beta: None,
            top: None,
            shape: Values::new(),
            seeds: vec![0, 1, 2],
            oracle: false,
            evaluate: true,
            episodes: 200,
            hide_history: false,
            settings: Values::new(),
        }
    }
}

/// Whether a job of this kind has such a setting, and an experiment leaves it to its file.
pub(super) fn has(job: &str, name: &str) -> bool {
    !OWN.contains(&name) && schema_of(job).iter().any(|(setting, _)| setting.name == name)
}

impl CellSettings {
    /// Checks every field.
    pub(crate) fn check(&self, cohorts: &[&str]) -> Result<(), String> {
        if self.seeds.is_empty() {
            return Err("seeds: give at least one".into());
        }
        if (1..self.seeds.len()).any(|index| self.seeds[..index].contains(&self.seeds[index])) {
            return Err("seeds: a value is duplicated; give each seed once".into());
        }
        if let Some(seed) = self.seeds.iter().find(|seed| **seed > HIGHEST_SEED) {
            return Err(format!("seeds: {seed} is too high; evaluations accept at most {HIGHEST_SEED}"));
        }
        if self.evaluate && self.episodes == 0 {
            return Err("episodes: give at least 1, or evaluate = false".into());
        }
        if !self.evaluate && !self.method.gleans {
            let method = self.method.title();
            return Err(format!("evaluate: {method} does not score, so evaluation is its only result; leave it true"));
        }
        if self.oracle && !self.method.gleans {
            let method = self.method.title();
            return Err(format!("oracle: {method} keeps no segments; leave it out, or choose a method that gleans"));
        }
        if let Some(beta) = self.beta.filter(|beta| !(0.0..=1.0).contains(beta)) {
            return Err(format!("beta: {beta} is outside [0, 1]"));
        }
        if let Some(top) = self.top.filter(|top| !(*top > 0.0 && *top <= 1.0)) {
            return Err(format!("top: {top} is outside (0, 1]"));
        }
        self.selection().map_err(|problem| format!("shape.{problem}"))?;
        self.check_settings()?;
        let ratio = self.rule.imperfect_per_expert;
        if !(ratio.is_finite() && ratio >= 0.0) {
            return Err(format!("rule.imperfect_per_expert: {ratio} is not a number from 0 on; 0 is all of them"));
        }
        match self.rule.cohorts.iter().find(|named| !cohorts.contains(&named.as_str())) {
            Some(unknown) => {
                Err(format!("rule.cohorts: {unknown:?} is not recorded; [data] has {}", cohorts.join(", ")))
            }
            None => Ok(()),
        }
    }

    fn check_settings(&self) -> Result<(), String> {
        let anywhere = |name: &str| ["pretrain", "score", "train"].iter().any(|job| has(job, name));
        if let Some(unknown) = self.settings.keys().find(|name| !anywhere(name)) {
            return Err(format!("unknown field `{unknown}`"));
        }
        for (job, settings) in [("pretrain", &self.pretrain), ("train", &self.train)] {
            if let Some(unknown) = settings.keys().find(|name| !has(job, name)) {
                return Err(format!("{job}: unknown field `{unknown}`"));
            }
        }
        self.pretrain_spec(0).map_err(|problem| within("pretrain", &self.pretrain, &problem))?;
        self.score_spec(0).map_err(|problem| problem.to_string())?;
        self.train_spec(0).map_err(|problem| within("train", &self.train, &problem))?;
        Ok(())
    }

    /// The threshold on q: the cell's, or that of its normaliser.
    pub(crate) fn beta(&self) -> f64 {
        // Settings that cannot be read are refused elsewhere.
        self.beta.unwrap_or_else(|| self.score_spec(0).unwrap_or_default().normaliser.default_beta())
    }

    /// The segments that are kept.
    pub(super) fn selection(&self) -> Result<Selection, Problem> {
        let rule = self.top.map_or_else(|| Rule::Beta(self.beta()), Rule::TopFraction);
        Ok(Selection { rule, shape: SelectionShape::from_values(&self.shape)? })
    }

    /// The settings of the pretraining.
    pub(super) fn pretrain_spec(&self, seed: u64) -> Result<PretrainSpec, Problem> {
        let mut values = self.shared(|name| has("pretrain", name));
        values.extend(self.pretrain.clone());
        values.insert("seed".to_owned(), seed.into());
        PretrainSpec::from_values(&values)
    }

    /// The settings of the scoring; the seed matters to scorers with random numbers alone.
    pub(super) fn score_spec(&self, seed: u64) -> Result<ScoreSpec, Problem> {
        let used = self.scorer()?;
        let mut values = self.shared(|name| has("score", name) && used.uses(name));
        if used.uses("seed") {
            values.insert("seed".to_owned(), seed.into());
        }
        ScoreSpec::from_values(&values)
    }

    /// The settings of the training.
    pub(super) fn train_spec(&self, seed: u64) -> Result<TrainSpec, Problem> {
        let used = self.training();
        let mut values = self.shared(|name| has("train", name) && used.uses(name));
        values.extend(self.train.clone());
        values.insert("policy".to_owned(), self.method.policy.into());
        values.insert("seed".to_owned(), seed.into());
        TrainSpec::from_values(&values)
    }

    fn shared(&self, wanted: impl Fn(&str) -> bool) -> Values {
        let settings = self.settings.iter().filter(|(name, _)| wanted(name));
        settings.map(|(name, value)| (name.clone(), value.clone())).collect()
    }
}

/// A problem under the table that holds the setting.
fn within(table: &str, settings: &Values, problem: &Problem) -> String {
    if settings.contains_key(&problem.field) { format!("{table}.{problem}") } else { problem.to_string() }
}

/// Which episodes a cell learns from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct RuleSettings {
    /// At most this many experts; 0: all that are recorded.
    pub(crate) experts: u32,
    /// At most this many imperfect episodes for each expert; 0: all.
    pub(crate) imperfect_per_expert: f64,
    /// Imperfect cohorts; none named: all.
    pub(crate) cohorts: Vec<String>,
    /// Which episodes a limit leaves in.
    pub(crate) seed: u64,
    /// Above 0, each seed draws episodes of its own: seed S as under `seed` + S × this.
    #[serde(skip_serializing_if = "is_zero")]
    pub(crate) seed_stride: u64,
}

impl RuleSettings {
    /// The rule of one seed of the cell.
    pub(crate) fn of(&self, seed: u64) -> Self {
        let offset = seed.saturating_mul(self.seed_stride);
        Self { seed: self.seed.saturating_add(offset), seed_stride: 0, ..self.clone() }
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "the form that serde calls")]
fn is_zero(stride: &u64) -> bool {
    *stride == 0
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_wrong_field_is_named() {
        let text = |change: &dyn Fn(&mut CellSettings)| {
            let mut cell = CellSettings::default();
            change(&mut cell);
            cell.check(&["freeze", "noise"]).unwrap_err()
        };
        assert!(CellSettings::default().check(&["freeze"]).is_ok());
        assert!(text(&|cell| cell.seeds = vec![1, 2, 1]).starts_with("seeds: "));
        let set = |name: &'static str, value: serde_json::Value| {
            move |cell: &mut CellSettings| {
                cell.settings.insert(name.into(), value.clone());
            }
        };
        assert!(text(&set("objectives", json!([]))).starts_with("objectives: has 0 values"));
        assert!(text(&set("lambda", json!(-1))).starts_with("lambda: is -1"));
        assert!(text(&set("lamda", json!(1))).contains("unknown field `lamda`"));
        assert!(text(&set("seed", json!(1))).contains("unknown field `seed`"));
        let steps = |cell: &mut CellSettings| {
            cell.pretrain.insert("steps".into(), json!(0));
        };
        assert!(text(&steps).starts_with("pretrain.steps: is 0"));
        assert!(text(&|cell| cell.episodes = 0).starts_with("episodes: "));
        assert!(text(&|cell| cell.top = Some(0.0)).starts_with("top: "));
        assert!(text(&|cell| cell.beta = Some(f64::NAN)).starts_with("beta: "));
        let shaped = |name: &'static str, value: serde_json::Value| {
            move |cell: &mut CellSettings| {
                cell.shape.insert(name.into(), value.clone());
            }
        };
        assert!(text(&shaped("phases", json!(0))).starts_with("shape.phases: is 0"));
        assert!(text(&shaped("min_runs", json!(5))).starts_with("shape.min_runs: unknown setting"));
        let unknown = text(&|cell| cell.rule.cohorts = vec!["freese".into()]);
        assert!(unknown.contains("\"freese\"") && unknown.contains("freeze, noise"), "{unknown}");
        for ratio in [-1.0, f64::NAN, f64::INFINITY] {
            let ratio = text(&|cell| cell.rule.imperfect_per_expert = ratio);
            assert!(ratio.starts_with("rule.imperfect_per_expert: "), "{ratio}");
        }
        let alone = text(&|cell| (cell.method, cell.oracle) = (Method { policy: "bc", gleans: false }, true));
        assert!(alone.starts_with("oracle: BC keeps no segments"), "{alone}");
        let idle = text(&|cell| (cell.method, cell.evaluate) = (Method { policy: "bc", gleans: false }, false));
        assert!(idle.starts_with("evaluate: BC"), "{idle}");
    }
}
