//! One inference step of a session: decode the observation, run the model on the session's history.

use std::{sync::Arc, time::Instant};

use super::{
    batch::StepResult,
    engine::{Engine, InferenceRequest},
    model::{Begin, Model, ModelInput},
    observation,
    pending_reply::PendingReply,
    record::show,
};
use crate::{domain::observation::Observation, error::Result, scorers::Watch};

/// The state of a session between two observations.
pub(super) struct Memory<H> {
    history: Option<H>,
    begin: Begin,
    /// The action sent last: taken as executed unless the robot sends another.
    pub(super) given: Option<Vec<f32>>,
    /// The newest observation of the history got no action: the executed action is unknown unless the robot sends it.
    pub(super) withheld: bool,
    /// Control steps since the newest one in the history that the model did not see.
    pub(super) unseen: u64,
    /// The action executed at the newest step of the history, where an observation that the model did not see has it.
    after: Option<Vec<f32>>,
    /// Scores the executed actions.
    pub(super) watch: Option<Watch>,
}

impl<H> Memory<H> {
    pub(super) fn new(begin: Begin, watch: Option<Watch>) -> Self {
        Self { history: None, begin, given: None, withheld: false, unseen: 0, after: None, watch }
    }

    /// Counts `unseen` more control steps that the model does not see. `after` is the action of the robot before the first of
    /// them.
    pub(super) fn pass_over(&mut self, unseen: u64, after: Option<Vec<f32>>) {
        if self.unseen == 0 {
            self.after = after;
        }
        self.unseen += unseen;
    }

    pub(super) fn take(&mut self) -> Self {
        std::mem::replace(self, Self::new(self.begin, None))
    }
}

/// The result of one observation.
#[derive(Debug)]
pub(super) enum StepAnswer {
    /// Actions in physical units, one per control period.
    Acted(Vec<Vec<f32>>),
    /// None: the deadline passed before the model was free, or the policy's own server does not answer, which is the
    /// reason then. The model did not run and the step stays unseen.
    Missed(String),
}

/// Answers one observation. Returns the session's next state and the answer.
///
/// # Errors
/// Invalid for a bad observation; Internal when the model fails; Unavailable when it is being unloaded, or when the
/// policy's own server does not answer an observation without a deadline; Precondition when that server's answer
/// cannot be used.
pub(super) async fn inference_step<M: Model>(
    engine: Arc<Engine<M>>,
    memory: Memory<M::History>,
    observation: Observation,
    reply: PendingReply,
) -> Result<(Memory<M::History>, StepAnswer)> {
    let Memory { history, begin, given, withheld, unseen, after, mut watch } = memory;
    let skipped = unseen + reply.dropped;
    let after = if skipped == 0 {
        Some(observation.executed_action.clone()).filter(|action| !action.is_empty())
    } else {
        after
    };
    let unrun = |history, (given, after), watch, reason| {
        let memory = Memory { history, begin, given, withheld, unseen: skipped + 1, after, watch };
        (memory, StepAnswer::Missed(reason))
    };
    if reply.is_late() {
        return Ok(unrun(history, (given, after), watch, String::new()));
    }
    let shape = engine.shape();
    let begun = Instant::now();
    let mut step = observation::step_of(Arc::clone(&shape), "observation", observation).await?;
    reply.stages.decoded(begun.elapsed());
    let gap = skipped > 0 || (withheld && step.executed.is_none());
    // That of a later step, which the model did not see, where no other is known.
    let later = step.executed.take();
    let known = after.clone().filter(|action| observation::vector("executed_action", action, shape.action).is_ok());
    step.executed = known.or_else(|| given.clone().filter(|_| !withheld)).or(later).or_else(|| given.clone());
    // Without any answer in time yet, the robot has executed nothing that is known: the history begins again, unless the
    // model reads one step alone. Then a chunk whose answer was late serves the steps after it.
    let history = history.filter(|_| step.executed.is_some() || engine.window() == 1);
    // The first step of a history has no executed action before it.
    step.executed = step.executed.filter(|_| history.is_some());
    if let Some(watch) = &mut watch {
        show(watch, reply.stamp_ns, &step, gap);
    }
    let input = ModelInput { history, begin, skipped, steps: vec![step] };
    Ok(match engine.infer_by(InferenceRequest { input, stages: reply.stages, deadline: reply.deadline }).await? {
        StepResult::Late(history) => unrun(history, (given, after), watch, String::new()),
        // A robot without a deadline has no other use for a session that cannot act.
        StepResult::Unanswered(_, error) if reply.deadline.is_none() => return Err(error),
        StepResult::Unanswered(history, error) => unrun(history, (given, after), watch, error.message().to_owned()),
        StepResult::Advanced(advanced) => {
            let history = Some(advanced.history);
            let acted = StepAnswer::Acted(advanced.actions);
            (Memory { history, begin, given, withheld: false, unseen: 0, after: None, watch }, acted)
        }
    })
}
