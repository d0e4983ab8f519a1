//! Robots: recorded sessions, one after the other. One that was closed is an episode.

use std::sync::Arc;

use gleaner_client::{Session, observation};
use gleaner_proto::v1::{Outcome, SessionOpen};
use gleaner_sim::{Sim, Task as SimTask};
use tokio_util::sync::CancellationToken;

use super::lab::{DEPLOYMENT, Lab, next_life};
use crate::lab as common;

/// The cohort of what sessions record.
pub const COHORT: &str = "rollout";

/// Holds sessions until told to stop. What a crash cuts off is begun anew.
pub async fn hold(lab: Arc<Lab>, stop: CancellationToken) {
    let mut seed = 0;
    while !stop.is_cancelled() {
        seed += 1;
        match attempt(&lab, seed).await {
            Ok(episode) => lab.ledger.rollout(episode),
            Err(error) if error.is_transient() => {}
            Err(error) => panic!("session {seed}: {error}"),
        }
        next_life(&lab).await;
    }
}

async fn attempt(lab: &Lab, seed: u64) -> gleaner_client::Result<String> {
    let open =
        SessionOpen { deployment: DEPLOYMENT.into(), record: true, cohort: COHORT.into(), ..SessionOpen::default() };
    let mut session = Session::open_with(&lab.client, open).await?;
    let spec = gleaner_sim::task_spec(SimTask::PickCube, &common::sim_config());
    let mut sim = Sim::new(SimTask::PickCube, common::sim_config(), seed);
    for _ in 0..4 {
        let seen = sim.observe();
        let answer = session.act(observation(&spec, seen.stamp_ns, seen.frames, seen.proprioception)?).await?;
        sim.step(answer.actions[0].values.as_slice().try_into().unwrap());
    }
    let closed = session.close_as(Outcome::Failure).await?;
    assert!(!closed.episode_id.is_empty(), "a recorded session has an episode");
    Ok(closed.episode_id)
}
