//! Robots: recorded sessions, one after the other. A closed session is an episode.

use std::sync::Arc;

use gleaner_client::Session;
use gleaner_proto::v1::{Outcome, SessionOpen};
use gleaner_sim::{Sim, Task as SimTask};
use tokio_util::sync::CancellationToken;

use super::lab::{DEPLOYMENT, Lab, next_life};
use crate::support::{lab as common, robot::observe};

/// The cohort of recorded sessions.
pub const COHORT: &str = "rollout";

/// Records sessions until it is cancelled. A session that a crash interrupts is followed by a new one.
pub async fn record(lab: Arc<Lab>, stop: CancellationToken) {
    let mut seed = 0;
    while !stop.is_cancelled() {
        seed += 1;
        match attempt(&lab, seed).await {
            Ok(episode) => lab.ledger.add_rollout(episode),
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
    let mut sim = Sim::new(SimTask::PickCube, common::sim_config(), seed);
    for _ in 0..4 {
        let reply = session.act(observe(&sim)).await?;
        sim.step(reply.actions[0].values.as_slice().try_into().unwrap());
    }
    let closed = session.close_as(Outcome::Failure).await?;
    assert!(!closed.episode_id.is_empty(), "a recorded session has an episode");
    Ok(closed.episode_id)
}
