//! The cells of a comparison: one for each scorer, with the settings that all of them share.
//!
//! Must not depend on a server.

use gleaner_core::kinds::Family;
use toml::{Table, Value};

use super::super::cell::{CellSettings, has};
use super::super::grid::set;
use super::super::method::Method;
use super::super::study::{Cell, one_line};

/// Parts of a cell that the command's own options set.
const OWN: [&str; 8] = ["method", "rule", "beta", "top", "seeds", "evaluate", "episodes", "scorer"];

/// The choices of a comparison.
#[derive(Clone, Debug)]
pub(super) struct Choice<'a> {
    /// `NAME [KEY=VALUE ...]` of each scorer; none: all that are offered.
    pub(super) scorers: &'a [String],
    /// Labels of score runs that exist, which come after the scorers.
    pub(super) runs: &'a [String],
    /// Scorers that can run, by name.
    pub(super) offered: &'a [String],
    /// `KEY=VALUE` of every scorer and job.
    pub(super) settings: &'a [String],
    /// The policy to train on each scorer's best part.
    pub(super) policy: Option<&'a str>,
    /// Whether encoders are pretrained.
    pub(super) pretrains: bool,
    /// The best part, in (0, 1].
    pub(super) top: f64,
    /// Attempts of each policy in the simulator.
    pub(super) attempts: u32,
    /// The number of seeds.
    pub(super) seeds: u64,
}

impl Choice<'_> {
    /// The cells.
    ///
    /// # Errors
    /// The option and the field that cannot be used.
    pub(super) fn cells(&self) -> Result<Vec<Cell>, String> {
        if !(self.top > 0.0 && self.top <= 1.0) {
            return Err(format!("--top-fraction: {} is outside (0, 1]", self.top));
        }
        let mut base = Table::new();
        let mut keys = Vec::with_capacity(self.settings.len());
        for text in self.settings {
            let here = |problem: String| format!("--set {text}: {problem}");
            let (key, value) = pair(text).map_err(here)?;
            self.check_effect(&key).map_err(here)?;
            set(&mut base, &key, value).map_err(here)?;
            keys.push(key);
        }
        let named = if self.scorers.is_empty() { self.offered } else { self.scorers };
        if named.is_empty() {
            return Err("--scorer: the server has no scorer that can run on this task".into());
        }
        let mut cells: Vec<Cell> = Vec::with_capacity(named.len());
        for text in named {
            let cell = self.cell(&base, text).map_err(|problem| format!("--scorer {text:?}: {problem}"))?;
            if cells.iter().any(|other| other.label == cell.label) {
                return Err(format!("--scorer {text:?}: is duplicated"));
            }
            cells.push(cell);
        }
        for key in &keys {
            let effects = cells.iter().map(|cell| cell.settings.check_varied(std::iter::once(key.as_str())));
            let without: Vec<String> = effects.filter_map(Result::err).collect();
            if without.len() == cells.len() {
                return Err(format!("--set {}", without.join("; ")));
            }
        }
        let shared = cells[0].settings.clone();
        for label in self.runs {
            if cells.iter().any(|other| other.label == *label) {
                return Err(format!("--run {label}: is duplicated"));
            }
            cells.push(Cell { label: label.clone(), varied: Vec::new(), settings: shared.clone() });
        }
        Ok(cells)
    }

    fn cell(&self, base: &Table, text: &str) -> Result<Cell, String> {
        let mut words = text.split_whitespace();
        let name = words.next().unwrap_or_default();
        if self.offered.iter().all(|offered| offered != name) {
            return Err(format!("unknown scorer or one that cannot run here; supported: {}", self.offered.join(", ")));
        }
        let mut table = base.clone();
        table.insert(Family::Scorer.as_str().to_owned(), name.into());
        let (mut label, mut varied) = (name.to_owned(), Vec::new());
        for word in words {
            let (key, value) = pair(word)?;
            if OWN.contains(&key.as_str()) || !has("score", &key) {
                return Err(format!("{key}: is not a setting of scorers; `gleaner kinds score` lists them"));
            }
            label = format!("{label} {word}");
            varied.push((key.clone(), serde_json::to_value(&value).map_err(|error| error.to_string())?));
            set(&mut table, &key, value)?;
        }
        let settings: CellSettings = table.try_into().map_err(|error: toml::de::Error| one_line(&error))?;
        let settings = CellSettings {
            method: self.method()?,
            top: Some(self.top),
            seeds: (0..self.seeds).collect(),
            evaluate: self.policy.is_some(),
            episodes: self.attempts,
            ..settings
        };
        settings.check(&[])?;
        settings.check_varied(varied.iter().map(|(key, _)| key.as_str()))?;
        Ok(Cell { label, varied, settings })
    }

    fn method(&self) -> Result<Method, String> {
        let Some(policy) = self.policy else { return Ok(Method::default()) };
        let kind = Family::Policy.kind(policy).map_err(|problem| format!("--train: {}", problem.message))?;
        Ok(Method { policy: &kind.name, gleans: true })
    }

    /// Fails for a key that no job of this comparison has.
    fn check_effect(&self, key: &str) -> Result<(), String> {
        let (pretrain, train) = (self.pretrains.then_some("pretrain"), self.policy.map(|_| "train"));
        let jobs: Vec<&str> = [Some("score"), pretrain, train].into_iter().flatten().collect();
        let first = key.split('.').next().unwrap_or_default();
        if OWN.contains(&first) {
            return Err(format!("{first}: has an option of its own or a fixed value; `--set` takes settings of jobs"));
        }
        let anywhere = |name: &str| ["pretrain", "score", "train"].iter().any(|job| has(job, name));
        let effective = match first {
            "pretrain" | "train" => jobs.contains(&first),
            "hide_history" => train.is_some(),
            // The cell rejects a name that is unknown everywhere.
            name => !anywhere(name) || jobs.iter().any(|job| has(job, name)),
        };
        if effective {
            return Ok(());
        }
        Err(format!("{key}: has no effect: this comparison has only jobs of the kinds {}", jobs.join(", ")))
    }
}

/// `KEY=VALUE`; a value that is not TOML is a word.
fn pair(text: &str) -> Result<(String, Value), String> {
    let (key, value) = text.split_once('=').ok_or_else(|| format!("{text}: expected KEY=VALUE"))?;
    let parsed = format!("value = {value}").parse::<Table>().ok().and_then(|mut table| table.remove("value"));
    Ok((key.to_owned(), parsed.unwrap_or_else(|| value.into())))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(scorers: &[&str], settings: &[&str], policy: Option<&str>) -> Result<Vec<Cell>, String> {
        let [scorers, settings] = [scorers, settings].map(|words| words.iter().map(ToString::to_string).collect());
        let (scorers, settings): (Vec<String>, Vec<String>) = (scorers, settings);
        let offered = ["raw", "ssdf", "deminf"].map(str::to_owned);
        let choice = Choice {
            scorers: &scorers,
            runs: &[],
            offered: &offered,
            settings: &settings,
            policy,
            pretrains: false,
            top: 0.25,
            attempts: 3,
            seeds: 2,
        };
        choice.cells()
    }

    #[test]
    fn every_offered_scorer_is_compared_by_default() {
        let cells = cells(&[], &["normaliser=quantile"], None).unwrap();
        let labels: Vec<&str> = cells.iter().map(|cell| cell.label.as_str()).collect();
        assert_eq!(labels, ["raw", "ssdf", "deminf"]);
        assert!(cells.iter().all(|cell| cell.settings.settings["normaliser"] == "quantile"));
        let settings = &cells[0].settings;
        assert_eq!((settings.top, &settings.seeds, settings.evaluate), (Some(0.25), &vec![0, 1], false));
    }

    #[test]
    fn a_scorer_may_have_settings_of_its_own() {
        let scorers = ["raw", "raw local_scale=false scale=[1,0.5,1]"];
        let cells = cells(&scorers, &["train.steps=5", "similarity=last_cosine"], Some("bc")).unwrap();
        assert_eq!(cells[1].label, "raw local_scale=false scale=[1,0.5,1]");
        let spec = cells[1].settings.score_spec(0).unwrap().values();
        assert_eq!((&spec["local_scale"], &spec["similarity"]), (&false.into(), &"last_cosine".into()));
        let training = cells[0].settings.train_spec(1).unwrap().values();
        assert_eq!((&training["policy"], &training["steps"], &training["seed"]), (&"bc".into(), &5.into(), &1.into()));
        assert!(cells[0].settings.evaluate);
    }

    #[test]
    fn wrong_options_are_named() {
        for (scorers, settings, policy, parts) in [
            (&["cupid"][..], &[][..], None, ["--scorer \"cupid\"", "supported: raw, ssdf, deminf"]),
            (&["raw", "raw"], &[], None, ["--scorer \"raw\"", "duplicated"]),
            (&["raw feature_scale=plain"], &[], None, ["feature_scale: has no effect", "raw"]),
            (&["raw steps=5"], &[], None, ["steps: is not a setting of scorers", "gleaner kinds score"]),
            (&["raw local_scale"], &[], None, ["local_scale", "KEY=VALUE"]),
            (&[], &["train.steps=5"], None, ["--set train.steps=5", "has no effect"]),
            (&[], &["objectives=[\"tr\"]"], Some("bc"), ["--set objectives", "has no effect"]),
            (&[], &["top=0.5"], None, ["--set top=0.5", "option of its own"]),
            (&["deminf"], &["similarity=segment_l2", "local_scale=false"], None, ["--set local_scale", "deminf"]),
            (&[], &["lamda=1"], Some("bc"), ["raw", "unknown field `lamda`"]),
            (&[], &["train.steps=0"], Some("bc"), ["train.steps", "is 0"]),
            (&[], &[], Some("gpt"), ["--train", "unknown value"]),
        ] {
            let message = cells(scorers, settings, policy).unwrap_err();
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
    }
}
