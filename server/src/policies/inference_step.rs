//! One inference step of a session: decode the observation, run the model on the session's history.

use std::{sync::Arc, time::Instant};

use super::{
    batch::StepResult,
    engine::{Engine, InferenceRequest},
    model::{Model, ModelInput},
    observation,
    pending_reply::PendingReply,
    record::show,
};
use crate::{domain::observation::Observation, error::Result, scorers::Watch};

/// The state of a session between two observations.
pub(super) struct Memory<H> {
    history: Option<H>,
    /// Seed of the numbers that the policy draws its actions from.
    seed: u64,
    /// The action sent last: taken as executed unless the robot sends another.
    pub(super) given: Option<Vec<f32>>,
    /// The newest observation of the history got no action: the executed action is unknown unless the robot sends it.
    pub(super) withheld: bool,
    /// Control steps since the newest one in the history that the model did not see.
    pub(super) unseen: u64,
    /// Scores the executed actions.
    pub(super) watch: Option<Watch>,
}

impl<H> Memory<H> {
    pub(super) fn new(seed: u64, watch: Option<Watch>) -> Self {
        Self { history: None, seed, given: None, withheld: false, unseen: 0, watch }
    }

    pub(super) fn take(&mut self) -> Self {
        std::mem::replace(self, Self::new(self.seed, None))
    }
}

/// Answers one observation. Returns the session's next state and the actions, in physical units, one per control
/// period; `None` when the deadline passed before the model was free, so that the model did not run and the step stays
/// unseen.
///
/// # Errors
/// Invalid for a bad observation; Internal when the model fails; Unavailable when it is being unloaded.
pub(super) async fn inference_step<M: Model>(
    engine: Arc<Engine<M>>,
    memory: Memory<M::History>,
    observation: Observation,
    reply: PendingReply,
) -> Result<(Memory<M::History>, Option<Vec<Vec<f32>>>)> {
    let Memory { history, seed, given, withheld, unseen, mut watch } = memory;
    let skipped = unseen + reply.dropped;
    let unrun = |history, given, watch| (Memory { history, seed, given, withheld, unseen: skipped + 1, watch }, None);
    if reply.is_late() {
        return Ok(unrun(history, given, watch));
    }
    let shape = engine.shape();
    let begun = Instant::now();
    let mut step = observation::step_of(shape, "observation", observation).await?;
    reply.stages.decoded(begun.elapsed());
    let gap = skipped > 0 || (withheld && step.executed.is_none());
    step.executed = step.executed.or_else(|| given.clone());
    // Without any answer in time yet, the robot has executed nothing that is known: the history begins again.
    let history = history.filter(|_| step.executed.is_some());
    // The first step of a history has no executed action before it.
    step.executed = step.executed.filter(|_| history.is_some());
    if let Some(watch) = &mut watch {
        show(watch, reply.stamp_ns, &step, gap);
    }
    let input = ModelInput { history, seed, skipped, steps: vec![step] };
    Ok(match engine.infer_by(InferenceRequest { input, stages: reply.stages, deadline: reply.deadline }).await? {
        StepResult::Late(history) => unrun(history, given, watch),
        StepResult::Advanced(advanced) => {
            let history = Some(advanced.history);
            (Memory { history, seed, given, withheld: false, unseen: 0, watch }, Some(advanced.actions))
        }
    })
}
