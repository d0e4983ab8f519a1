//! Every size of the demo in one place.

use gleaner_client::ClientError;
use gleaner_sim::{AgentKind, AgentSpec, Cohort, SimConfig, Task};
use serde::{Deserialize, Serialize};
use std::path::Path;

use crate::cmd::record::RecordSet;
use crate::failure::{Failure, Result};
use gleaner_core::NormaliserKind;

/// Sizes, seeds and thresholds. Chosen by measurement, so that the demo ends well within 10 minutes on 2 cores.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct DemoPlan {
    /// Camera height and width in pixels.
    pub(crate) image: u32,
    /// Episodes of the scripted expert.
    pub(crate) experts: usize,
    /// Episodes of each kind of imperfect agent.
    pub(crate) imperfect_of_each_kind: usize,
    /// How badly they go wrong, 0 to 1.
    pub(crate) grade: f64,
    /// The first recorded episode's seed.
    pub(crate) record_seed: u64,
    /// Seed of the trainings.
    pub(crate) train_seed: u64,
    /// Optimiser steps and segments a step of the pretraining.
    pub(crate) pretrain_steps: u32,
    pub(crate) pretrain_batch: u32,
    /// Optimiser steps and segments a step of both policies.
    pub(crate) train_steps: u32,
    pub(crate) train_batch: u32,
    /// What q is of w.
    pub(crate) normaliser: NormaliserKind,
    /// Weight of the kept segments' loss.
    pub(crate) lambda: f64,
    /// The dataset's threshold.
    pub(crate) beta: f64,
    /// Thresholds that are reported.
    pub(crate) betas: Vec<f64>,
    /// Episodes that each policy is evaluated on, the first one's seed, and how many run at a time.
    pub(crate) evaluation_episodes: u32,
    pub(crate) evaluation_seed: u64,
    pub(crate) sessions: usize,
}

impl Default for DemoPlan {
    fn default() -> Self {
        Self {
            image: 32,
            experts: 60,
            imperfect_of_each_kind: 30,
            grade: 1.0,
            record_seed: 0,
            train_seed: 0,
            // The encoder decides what both policies reach: with half as many segments a third of the attempts succeed.
            pretrain_steps: 2_000,
            pretrain_batch: 64,
            train_steps: 1_500,
            train_batch: 32,
            // λ and β are the paper's. Under `minmax` one odd segment moves every other q, and with it what β keeps; by
            // quantile β = 0.9 is the best tenth.
            normaliser: NormaliserKind::Quantile,
            lambda: 0.1,
            beta: 0.9,
            betas: vec![0.5, 0.7, 0.8, 0.9, 0.95],
            evaluation_episodes: 200,
            evaluation_seed: 1_000_000,
            sessions: 4,
        }
    }
}

impl DemoPlan {
    /// The smallest plan that runs every stage; its numbers have no meaning.
    pub(crate) fn quick() -> Self {
        Self {
            experts: 4,
            imperfect_of_each_kind: 1,
            pretrain_steps: 20,
            pretrain_batch: 16,
            train_steps: 20,
            train_batch: 16,
            evaluation_episodes: 4,
            ..Self::default()
        }
    }

    /// From a TOML file; what it leaves out is as in the full demo.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(ClientError::io(path))?;
        toml::from_str(&text).map_err(|error| Failure::told(format!("{}: {error}", path.display())))
    }

    pub(crate) fn task(&self) -> Task {
        Task::PickCube
    }

    pub(crate) fn config(&self) -> SimConfig {
        SimConfig { image: self.image, ..SimConfig::default() }
    }

    /// Every kind of imperfect agent.
    pub(crate) fn imperfect_kinds() -> impl Iterator<Item = AgentKind> {
        AgentKind::ALL.into_iter().filter(|kind| *kind != AgentKind::Expert)
    }

    pub(crate) fn record_set(&self) -> Result<RecordSet> {
        let mut cohorts: Vec<Cohort> = vec![(AgentSpec::EXPERT, self.experts).into()];
        for kind in Self::imperfect_kinds() {
            let agent = AgentSpec::new(kind, self.grade)?;
            cohorts.push((agent, self.imperfect_of_each_kind).into());
        }
        Ok(RecordSet { task: self.task(), config: self.config(), cohorts, seed: self.record_seed })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_of_agent_is_recorded() {
        let set = DemoPlan::default().record_set().unwrap();
        assert_eq!(set.cohorts.len(), AgentKind::ALL.len());
        assert_eq!(set.cohorts[0].agent, AgentSpec::EXPERT);
    }

    #[test]
    fn the_full_demo_evaluates_on_at_least_200_unseen_episodes() {
        let plan = DemoPlan::default();
        assert!(plan.evaluation_episodes >= 200);
        let recorded = plan.experts + plan.imperfect_of_each_kind * DemoPlan::imperfect_kinds().count();
        assert!(plan.evaluation_seed > plan.record_seed + recorded as u64);
        assert!(plan.betas.contains(&plan.beta));
    }

    #[test]
    fn a_plan_file_changes_what_it_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plan.toml");
        std::fs::write(&path, "experts = 7\n").unwrap();
        let plan = DemoPlan::read(&path).unwrap();
        assert_eq!((plan.experts, plan.train_steps), (7, DemoPlan::default().train_steps));
        std::fs::write(&path, "expert = 7\n").unwrap();
        assert!(DemoPlan::read(&path).unwrap_err().to_string().contains("expert"));
    }
}
