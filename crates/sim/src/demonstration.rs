//! Demonstrations: the attempt of an agent, with the mark of its first wrong step, and its recording.
//!
//! This module does not depend on the decisions of agents or on rendering.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::Path;

use glam::Vec2;
use gleaner_recording::{EpisodeWriter, StepRef};

use crate::agent::{AgentKind, AgentSpec, Expert, FalseStart, Fault, Rehearsal};
use crate::config::SimConfig;
use crate::error::SimError;
use crate::sim::{Observation, Sim, Stream, random};
use crate::task::{ACTION_SIZE, Task, task_spec};

/// Name of the metadata record with agent, seed, outcome and mark. No mapping reads metadata.
pub const METADATA: &str = "gleaner.sim";

/// The departure of an action that opens the gripper where the expert closes it, or the other way round.
const OTHER_GRIPPER: f32 = 2.0;

/// One attempt by an agent. Step t is `observations[t]`, then `actions[t]`.
#[derive(Clone, Debug)]
pub struct Demonstration {
    /// The task.
    pub task: Task,
    /// The settings.
    pub config: SimConfig,
    /// The agent.
    pub agent: AgentSpec,
    /// The seed of all random choices.
    pub seed: u64,
    /// The observation before each action.
    pub observations: Vec<Observation>,
    /// The actions, each as in [`Sim::step`].
    pub actions: Vec<[f32; ACTION_SIZE]>,
    /// Whether the task succeeded.
    pub success: bool,
    /// The end of a false start: the first step that follows the script. `None` without one.
    pub went_right: Option<u32>,
    /// The mark: the first step, after a false start, whose action differs from the expert's in the same state.
    pub went_wrong: Option<u32>,
    /// The distance of each action from the expert's in the same state, in action units, 0 to 2: the largest difference of
    /// a displacement or rotation, or 2 if the gripper commands differ. After a fault the expert's action is the recovery.
    pub departure: Vec<f32>,
}

/// The end of an attempt.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Ending {
    pub(crate) success: bool,
    pub(crate) went_right: Option<u32>,
    pub(crate) went_wrong: Option<u32>,
    pub(crate) departure: Vec<f32>,
}

/// Runs an attempt of an agent. The same arguments always give the same bytes.
#[must_use]
pub fn demonstrate(task: Task, config: SimConfig, agent: AgentSpec, seed: u64) -> Demonstration {
    let mut observations = Vec::new();
    let mut actions = Vec::new();
    let sim = Sim::new(task, config, seed);
    let ending = attempt(sim, agent, seed, |sim, action| {
        observations.push(sim.observe());
        actions.push(*action);
    });
    Demonstration {
        task,
        config,
        agent,
        seed,
        observations,
        actions,
        success: ending.success,
        went_right: ending.went_right,
        went_wrong: ending.went_wrong,
        departure: ending.departure,
    }
}

/// Runs an attempt to its end; calls `on_step` with each state and the next action.
pub(crate) fn attempt(
    mut sim: Sim,
    agent: AgentSpec,
    seed: u64,
    mut on_step: impl FnMut(&Sim, &[f32; ACTION_SIZE]),
) -> Ending {
    // The expert's action in each state, with the random habits of the agent's script.
    let mut expert = Expert::new(sim.task(), random(seed, Stream::Expert));
    let mut false_start = agent.false_start().then(|| FalseStart::new(random(seed, Stream::FalseStart)));
    let went_right = false_start.as_ref().map(FalseStart::steps);
    let mut fault = match agent.kind() {
        AgentKind::Expert => None,
        AgentKind::MissedGrasp
        | AgentKind::EarlyRelease
        | AgentKind::WrongGoal
        | AgentKind::Freeze
        | AgentKind::Wander
        | AgentKind::Noise => Some(Fault::new(
            sim.task(),
            agent,
            rehearse(sim.clone(), expert.clone(), false_start.clone()),
            random(seed, Stream::Expert),
            random(seed, Stream::Fault),
        )),
    };
    let mut went_wrong = None;
    let mut departures = Vec::new();
    while !sim.done() {
        let step = sim.steps();
        let expected = expert.act(sim.world());
        let mut action = match &mut fault {
            Some(fault) => fault.act(step, sim.world()),
            None => expected,
        };
        if let Some(false_start) = &mut false_start {
            false_start.divert(step, sim.world(), &mut action);
        }
        let follows = went_right.is_none_or(|from| step >= from);
        if went_wrong.is_none() && follows && action != expected {
            went_wrong = Some(step);
        }
        departures.push(departure(&action, &expected));
        on_step(&sim, &action);
        sim.step(&action);
    }
    Ending { success: sim.success(), went_right, went_wrong, departure: departures }
}

/// The distance of two actions, as in [`Demonstration::departure`].
fn departure(action: &[f32; ACTION_SIZE], expected: &[f32; ACTION_SIZE]) -> f32 {
    if (action[6] < 0.0) != (expected[6] < 0.0) {
        return OTHER_GRIPPER;
    }
    action[..6].iter().zip(&expected[..6]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// Runs the expert's own attempt, after the false start if there is one.
fn rehearse(mut sim: Sim, mut expert: Expert, mut false_start: Option<FalseStart>) -> Rehearsal {
    let begin = false_start.as_ref().map_or(0, FalseStart::steps);
    let place = (sim.task().rules().place)(sim.world(), Vec2::ZERO).truncate();
    let (mut carry, mut carry_end) = (None, None);
    while !sim.done() {
        let mut action = expert.act(sim.world());
        if let Some(false_start) = &mut false_start {
            false_start.divert(sim.steps(), sim.world(), &mut action);
        }
        if expert.carries() {
            carry.get_or_insert(sim.steps());
            carry_end = Some(sim.steps() + 1);
        }
        sim.step(&action);
    }
    let steps = sim.steps();
    Rehearsal {
        begin: begin.min(steps),
        steps,
        carry: carry.unwrap_or(steps),
        carry_end: carry_end.unwrap_or(steps),
        place,
    }
}

impl Demonstration {
    /// Number of steps, T.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.actions.len()
    }

    /// For each step, whether it is in a false start, or at or after the mark. A step after the mark is not necessarily bad.
    #[must_use]
    pub fn mark(&self) -> Vec<bool> {
        let early = |step| self.went_right.is_some_and(|from| step < from);
        let late = |step| self.went_wrong.is_some_and(|from| step >= from);
        (0_u32..).zip(&self.actions).map(|(step, _)| early(step) || late(step)).collect()
    }

    /// Writes the recording; returns the writer.
    ///
    /// # Errors
    /// [`SimError::Recording`] if it cannot be written.
    pub fn write_mcap<W: Write + Seek>(&self, writer: W) -> Result<W, SimError> {
        let spec = task_spec(self.task, &self.config);
        let mut episode = EpisodeWriter::create(writer, &spec)?;
        for (observation, action) in self.observations.iter().zip(&self.actions) {
            let step = StepRef { frames: &observation.frames, proprioception: &observation.proprioception, action };
            episode.step(observation.stamp_ns, step)?;
        }
        episode.metadata(METADATA, self.metadata())?;
        Ok(episode.finish()?)
    }

    /// Writes the recording to a file.
    ///
    /// # Errors
    /// [`SimError::Io`] or [`SimError::Recording`] if it cannot be written.
    pub fn save_mcap(&self, path: &Path) -> Result<(), SimError> {
        let failed = |source| SimError::Io { path: path.to_owned(), source };
        let file = File::create(path).map_err(failed)?;
        let mut writer = self.write_mcap(BufWriter::new(file))?;
        writer.flush().map_err(failed)
    }

    fn metadata(&self) -> BTreeMap<String, String> {
        let mark = self.went_wrong.map(|step| step.to_string());
        [
            ("agent", self.agent.to_string()),
            ("seed", self.seed.to_string()),
            ("success", self.success.to_string()),
            ("went_wrong", mark.unwrap_or_default()),
        ]
        .into_iter()
        .chain(self.went_right.map(|step| ("went_right", step.to_string())))
        .map(|(key, value)| (key.to_owned(), value))
        .collect()
    }
}

#[cfg(test)]
mod tests;
