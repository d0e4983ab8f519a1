//! The plan of the demo: its experiment file, and the settings that a file or `--quick` lays over it.
//!
//! Must not depend on a server.

use serde::Deserialize;
use toml::Table;

use super::super::cell::CellSettings;
use super::super::file::Experiment;
use super::super::grid::merge;
use crate::cmd::record::RecordSet;

const DEMO: &str = include_str!("demo.toml");
/// The smallest sizes that run every stage.
pub(super) const QUICK: &str = include_str!("quick.toml");
// The report has the cells of the demo's own study.
const OPEN: [&str; 4] = ["data", "base", "betas", "drive"];

/// The evaluations over the endpoint that robots use.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Drive {
    /// Seed of the first episode; each further one adds 1.
    pub(super) seed: u64,
    /// Episodes that run at once.
    pub(super) sessions: usize,
}

impl Drive {
    /// Fails if one of the attempts is among the recordings, so that a policy would be tried on what it was trained on.
    fn check(&self, recordings: &RecordSet, episodes: u32) -> Result<(), String> {
        let (first, end) = (recordings.seed, recordings.seed.saturating_add(recordings.total()));
        if self.seed >= end || self.seed.saturating_add(episodes.into()) <= first {
            return Ok(());
        }
        Err(format!("drive.seed: attempts from {} on are recorded as well; give at least {end}", self.seed))
    }
}

/// Everything that the demo does.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub(super) experiment: Experiment,
    pub(super) recordings: RecordSet,
    /// Thresholds that are reported.
    pub(super) betas: Vec<f64>,
    pub(super) drive: Drive,
    /// As in the file.
    pub(super) settings: Table,
}

impl Plan {
    /// The demo with these settings (TOML) in place of its own.
    ///
    /// # Errors
    /// The place and the field of the first setting that cannot be used.
    pub(super) fn with(settings: &str) -> Result<Self, String> {
        let parse = |text: &str| toml::from_str::<Table>(text).map_err(|error| error.to_string());
        let (mut file, given) = (parse(DEMO)?, parse(settings)?);
        if let Some(key) = given.keys().find(|key| !OPEN.contains(&key.as_str())) {
            return Err(format!("{key}: not a setting of the demo; supported: {}", OPEN.join(", ")));
        }
        merge(&mut file, &given);
        let settings = file.clone();
        let betas = take(&mut file, "betas")?;
        let drive: Drive = take(&mut file, "drive")?;
        let mut experiment = Experiment::from_table(file)?;
        if let Some(cell) = cells(&experiment).find(|cell| cell.seeds.len() != 1) {
            return Err(format!("base.seeds: has {} seeds; the demo trains with one", cell.seeds.len()));
        }
        let recordings = experiment.recordings.source().simulated();
        let recordings = recordings.cloned().ok_or("data.folder: the demo records in the simulator; leave it out")?;
        drive.check(&recordings, cells(&experiment).map(|cell| cell.episodes).max().unwrap_or(0))?;
        // Its server has no other recordings.
        experiment.recordings.rename(recordings.task.name())?;
        Ok(Self { experiment, recordings, betas, drive, settings })
    }

    /// The cells: experts alone, then experts and gleaned segments.
    pub(super) fn cells(&self) -> impl Iterator<Item = &CellSettings> {
        cells(&self.experiment)
    }
}

fn cells(experiment: &Experiment) -> impl Iterator<Item = &CellSettings> {
    experiment.studies.iter().flat_map(|study| &study.cells).map(|cell| &cell.settings)
}

fn take<'de, T: Deserialize<'de>>(table: &mut Table, key: &str) -> Result<T, String> {
    let value = table.remove(key).ok_or_else(|| format!("{key}: is missing"))?;
    value.try_into().map_err(|error: toml::de::Error| format!("{key}: {}", error.message()))
}

#[cfg(test)]
mod tests {
    use gleaner_core::proto::to_struct;
    use gleaner_core::selection::Selection;
    use gleaner_core::{Device, PretrainSpec, ScoreSpec, TrainSpec};
    use gleaner_proto::v1::job_spec::Spec;
    use gleaner_proto::v1::train_spec::Data;
    use gleaner_sim::{AgentKind, AgentSpec, SimConfig};
    use serde_json::{Value, json};

    use super::super::super::order::{self, Input};
    use super::super::super::stage::{Graph, Work};
    use super::*;

    #[test]
    fn the_demo_submits_a_chain_for_each_policy() {
        let plan = Plan::with("").unwrap();
        let (experiment, device) = (&plan.experiment, Device::default());
        let graph = Graph::without_evaluations(experiment, device);
        let kinds: Vec<&str> = graph.stages.iter().map(|stage| stage.work.kind()).collect();
        assert_eq!(kinds, ["snapshot", "pretrain", "train", "score", "dataset", "train"]);

        let imperfect = experiment.recordings.source().imperfect();
        let Work::Snapshot { task, rule } = &graph.stages[0].work else { panic!("not a snapshot") };
        let rule = order::rule(rule, "expert", &imperfect);
        let named: Vec<&str> = AgentKind::ALL.iter().skip(1).map(|kind| kind.name()).collect();
        assert_eq!((task.as_str(), &rule.expert_cohorts[..]), ("pick_cube", &["expert".to_owned()][..]));
        assert_eq!(rule.imperfect_cohorts, named);
        assert_eq!((rule.imperfect_per_expert, rule.max_experts, rule.seed), (0.0, 0, 0));

        // The settings, completed as the server does.
        let given = |settings: Value| settings.as_object().unwrap().clone();
        // No expert is held out.
        let training = json!({
            "policy": "bc", "initial_weights": "encoder", "steps": 1_500, "batch": 32, "seed": 0, "validation_share": 0.0,
        });
        let mut training = TrainSpec::from_values(&given(training)).unwrap().values();
        let pretraining = json!({"steps": 2_000, "batch": 64, "seed": 0, "action_token": "proprioception"});
        let pretraining = PretrainSpec::from_values(&given(pretraining)).unwrap().values();
        let scoring = ScoreSpec::from_values(&given(json!({"normaliser": "calibrated"}))).unwrap().values();
        let sent = |index: usize| {
            let stage = &graph.stages[index];
            let input = Input { kind: kinds[stage.input.unwrap()], id: "input", before: None };
            let (settings, data) = match order::job(&stage.work, input, "pick_cube", device).unwrap() {
                Spec::Pretrain(spec) => (spec.settings, None),
                Spec::Score(spec) => (spec.settings, None),
                Spec::Train(spec) => (spec.settings, spec.data),
                other @ (Spec::Export(_) | Spec::Evaluate(_)) => panic!("{other:?}"),
            };
            (settings.unwrap(), data)
        };
        assert_eq!(sent(1), (to_struct(&pretraining), None));
        assert_eq!(sent(3), (to_struct(&scoring), None));
        assert_eq!(sent(5), (to_struct(&training), Some(Data::DatasetId("input".into()))));
        // Without gleaned segments λ has no effect, and is left out.
        assert_eq!(training.remove("lambda"), Some(json!(0.3)));
        assert_eq!(training.remove("weighting"), Some("quality".into()));
        assert_eq!(sent(2), (to_struct(&training), Some(Data::ExpertsOf("input".into()))));
        assert_eq!(graph.stages[4].work, Work::Dataset { selection: Selection::beta(0.5) });
        let inputs: Vec<Option<usize>> = graph.stages.iter().map(|stage| stage.input).collect();
        assert_eq!(inputs, [None, Some(0), Some(1), Some(1), Some(3), Some(4)]);
    }

    #[test]
    fn the_full_demo_records_every_kind_of_agent_and_evaluates_on_200_unseen_episodes() {
        let plan = Plan::with("").unwrap();
        let set = &plan.recordings;
        let recorded: Vec<(AgentSpec, usize)> = set.cohorts.iter().map(|cohort| (cohort.agent, cohort.count)).collect();
        let imperfect = AgentKind::ALL.iter().skip(1).map(|kind| (AgentSpec::new(*kind, 1.0).unwrap(), 30));
        assert_eq!(recorded, [(AgentSpec::EXPERT, 60)].into_iter().chain(imperfect).collect::<Vec<_>>());
        assert_eq!((set.seed, set.config), (0, SimConfig { image: 32, ..SimConfig::default() }));
        assert!(plan.cells().all(|cell| cell.episodes >= 200));
        assert_eq!((plan.drive.seed, plan.drive.sessions), (1_000_000, 4));
        assert!(plan.drive.seed > set.seed + recorded.iter().map(|(_, count)| *count as u64).sum::<u64>());
        assert!(plan.cells().all(|cell| plan.betas.contains(&cell.beta())));
    }

    #[test]
    fn given_settings_change_only_the_settings_they_name() {
        let plan = Plan::with("[data]\nexperts = 7\n[base]\ntrain = { steps = 3 }\n").unwrap();
        assert_eq!(plan.recordings.cohorts[0].count, 7);
        let cell = plan.cells().next().unwrap();
        assert_eq!((&cell.train["steps"], &cell.train["batch"]), (&json!(3), &json!(32)));
        let quick = Plan::with(QUICK).unwrap();
        assert_eq!(quick.recordings.cohorts.len(), AgentKind::ALL.len());
        for (given, parts) in [
            ("[data]\nexpert = 7", ["unknown field", "expert"]),
            ("[base]\nlamda = 7", ["base", "lamda"]),
            ("[base]\nseeds = [1, 2]", ["base.seeds", "2 seeds"]),
            ("[drive]\nsesions = 7", ["drive", "sesions"]),
            ("[data]\nseed = 1000199", ["drive.seed: attempts from 1000000 on are recorded", "at least 1000439"]),
            ("[drive]\nseed = 239", ["drive.seed: attempts from 239 on are recorded", "at least 240"]),
            ("experts = 7", ["experts", "data, base"]),
        ] {
            let message = Plan::with(given).unwrap_err();
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
    }
}
