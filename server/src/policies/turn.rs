//! One observation's way through the model, on top of what its session remembers.

use std::{sync::Arc, time::Instant};

use super::{
    batch::Turned,
    due::Due,
    engine::{Ask, Engine},
    model::{Model, Turn},
    observation,
    record::show,
};
use crate::{domain::observation::Observation, error::Result, scorers::Watch};

/// What a session remembers from one observation to the next.
pub(super) struct Memory<H> {
    history: Option<H>,
    /// What the robot was given last: taken as executed unless it says otherwise.
    pub(super) given: Option<Vec<f32>>,
    /// The newest observation in the history got no action: what was done since is not known unless the robot says it.
    pub(super) withheld: bool,
    /// Control steps since the newest in the history that the model did not see.
    pub(super) unseen: u64,
    /// Scores what is done.
    pub(super) watch: Option<Watch>,
}

impl<H> Memory<H> {
    pub(super) fn new(watch: Option<Watch>) -> Self {
        Self { history: None, given: None, withheld: false, unseen: 0, watch }
    }

    pub(super) fn take(&mut self) -> Self {
        std::mem::replace(self, Self::new(None))
    }
}

/// Answers one observation: what is remembered then, and the actions, in physical units, one a control period; `None`
/// when the deadline passed before the model was free, so that it did not run and the step stays unseen.
///
/// # Errors
/// Invalid for a bad observation; Internal when the model fails; Unavailable when it is being unloaded.
pub(super) async fn turn<M: Model>(
    engine: Arc<Engine<M>>,
    memory: Memory<M::History>,
    observation: Observation,
    due: Due,
) -> Result<(Memory<M::History>, Option<Vec<Vec<f32>>>)> {
    let Memory { history, given, withheld, unseen, mut watch } = memory;
    let skipped = unseen + due.dropped;
    let unrun = |history, given, watch| (Memory { history, given, withheld, unseen: skipped + 1, watch }, None);
    if due.is_late() {
        return Ok(unrun(history, given, watch));
    }
    let shape = engine.shape();
    let begun = Instant::now();
    let mut step = observation::step_of(shape, "observation", observation).await?;
    due.stages.decoded(begun.elapsed());
    let gap = skipped > 0 || (withheld && step.executed.is_none());
    // The first step of a history has nothing before it.
    step.executed = step.executed.or_else(|| given.clone()).filter(|_| history.is_some());
    if let Some(watch) = &mut watch {
        show(watch, due.stamp_ns, &step, gap);
    }
    let turn = Turn { history, skipped, steps: vec![step] };
    Ok(match engine.ask_by(Ask { turn, stages: due.stages, deadline: due.deadline }).await? {
        Turned::Late(history) => unrun(history, given, watch),
        Turned::Advanced(advanced) => {
            let history = Some(advanced.history);
            (Memory { history, given, withheld: false, unseen: 0, watch }, Some(advanced.actions))
        }
    })
}
