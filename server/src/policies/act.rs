//! `Act`: one action from a window of observations that the client keeps. Stateless on the server.

use std::{sync::Arc, time::Instant};

use super::{
    engine::{Engine, InferenceRequest},
    model::{Begin, Model, ModelInput, Step},
    observation,
    stages::Stages,
};
use crate::{
    domain::observation::{Acted, Observation},
    error::{Error, Result},
};

/// Answers the last of a window of observations by its deadline.
///
/// # Errors
/// Invalid, naming the field; Exhausted when the queue is full; Late when the deadline passes first.
pub(super) async fn act<M: Model>(engine: &Engine<M>, observations: Vec<Observation>) -> Result<Acted> {
    let stages = Arc::new(Stages::begin());
    let Some((stamp_ns, within)) = observations.last().map(|last| (last.stamp_ns, last.deadline)) else {
        return Err(Error::invalid("observations", "must hold at least the current observation"));
    };
    let deadline = within.map(|within| stages.arrived() + within);
    let answered = async {
        let steps = steps(engine, observations).await?;
        stages.decoded(stages.arrived().elapsed());
        let input = ModelInput { history: None, begin: Begin::default(), skipped: 0, steps };
        engine.try_infer_by(InferenceRequest { input, stages: Arc::clone(&stages), deadline }).await?.advanced()
    };
    let in_time = async {
        match deadline {
            None => Ok(answered.await),
            Some(deadline) => tokio::time::timeout_at(deadline.into(), answered).await,
        }
    };
    let late = || Error::late("the observation's deadline passed before it was answered");
    let advanced = in_time.await.map_err(|_| late())??;
    if deadline.is_some_and(|deadline| deadline <= Instant::now()) {
        return Err(late());
    }
    let policy_id = engine.identity().policy_id.clone();
    Ok(Acted { stamp_ns, actions: advanced.actions, policy_id, timings: stages.timings() })
}

/// Checks and decodes the steps of the policy's window, off the runtime.
async fn steps<M: Model>(engine: &Engine<M>, observations: Vec<Observation>) -> Result<Vec<Step>> {
    let first = observations.len().saturating_sub(engine.window());
    let shape = engine.shape();
    observation::decode(move || {
        let recent = observations.iter().enumerate().skip(first);
        let mut steps: Vec<Step> = recent
            .map(|(index, observation)| observation::step(&shape, &format!("observations[{index}]"), observation))
            .collect::<Result<_>>()?;
        steps[0].executed = None;
        match steps.iter().skip(1).position(|step| step.executed.is_none()) {
            None => Ok(steps),
            Some(place) => Err(Error::invalid(
                &format!("observations[{}].executed_action", first + 1 + place),
                "must be set on every observation but the first: the server keeps no history for Act",
            )),
        }
    })
    .await
}

#[cfg(test)]
mod tests;
