//! Recorded sessions: a server with a scored deployment, and sessions whose every byte is known.

use std::{
    path::Path,
    sync::{Arc, Weak},
};

use gleaner_client::Session;
use gleaner_proto::v1::*;
use gleaner_recording::{Reading, read_episode};
use gleaner_sim::{Sim, Task as SimTask};
use tokio::sync::Mutex;

use super::{api::Api, lab, robot::observe, server::TestServer, wait::until};

pub const NAME: &str = "pick_cube@rollouts";

/// A server with a policy and a score run deployed together. It is not the shared server, because its tests add episodes.
pub struct ScoredDeployment {
    pub server: TestServer,
    pub experts: Vec<String>,
}

/// The server of [`ScoredDeployment`]; it ends with the last test that uses it.
pub async fn scored_deployment() -> Arc<ScoredDeployment> {
    static SHARED: Mutex<Weak<ScoredDeployment>> = Mutex::const_new(Weak::new());
    let mut held = SHARED.lock().await;
    if let Some(shared) = held.upgrade() {
        return shared;
    }
    let (server, mut api, episodes) = lab::with_episodes(&[]).await;
    let encoder = api.succeed(lab::TASK, lab::pretrain(2)).await.result_id;
    let score_run_id = api.succeed(lab::TASK, lab::score(&encoder)).await.result_id;
    let policy_id = api.succeed(lab::TASK, lab::train(train_spec::Data::ExpertsOf(encoder), 2)).await.result_id;
    api.policies
        .deploy(DeployRequest { name: NAME.into(), policy_id, score_run_id, hide_history: false })
        .await
        .unwrap();
    let experts = episodes.into_iter().filter(|one| one.outcome() == Outcome::Success).map(|one| one.id).collect();
    let shared = Arc::new(ScoredDeployment { server, experts });
    *held = Arc::downgrade(&shared);
    shared
}

/// The opening of a recorded session.
pub fn recorded(cohort: &str) -> SessionOpen {
    SessionOpen { deployment: NAME.into(), record: true, cohort: cohort.into(), ..SessionOpen::default() }
}

/// The episodes of a cohort, as soon as it has this number of them.
pub async fn episodes(api: &mut Api, cohort: &str, count: usize) -> Vec<Episode> {
    let request = ListEpisodesRequest { task: lab::TASK.into(), cohort: cohort.into(), ..Default::default() };
    until("the session becomes an episode", async || {
        let listed = api.episodes.list_episodes(request.clone()).await.unwrap().into_inner().episodes;
        (listed.len() >= count).then_some(listed)
    })
    .await
}

/// Downloads an episode and reads it.
pub async fn read(api: &mut Api, episode: &str) -> Reading {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rollout.mcap");
    std::fs::write(&path, api.download(episode).await).unwrap();
    read_episode(&path, &lab::spec()).unwrap()
}

/// The observations and actions of a session in lock step.
#[derive(Default)]
pub struct Sent {
    pub stamps: Vec<i64>,
    pub frames: Vec<u8>,
    pub proprioception: Vec<f32>,
    pub actions: Vec<f32>,
}

impl Sent {
    /// Adds an observation.
    pub fn add(&mut self, observation: &Observation) {
        self.stamps.push(observation.stamp_ns);
        self.proprioception.extend(&observation.proprioception);
        for camera in &observation.cameras {
            for image in [&camera.color, &camera.depth].into_iter().flatten() {
                self.frames.extend_from_slice(&image.data);
            }
        }
    }

    /// Checks that an episode has the same observations and actions.
    pub fn expect_equal(&self, reading: &Reading) {
        let steps = self.stamps.len();
        assert_eq!(reading.episode.stamps(), self.stamps);
        assert!(reading.episode.frames().as_ref() == self.frames, "the images of {steps} steps differ");
        assert_eq!(reading.episode.proprioception(), self.proprioception);
        assert_eq!(reading.episode.action(), self.actions);
    }
}

/// One step of a session in lock step: the simulator executes the action of the reply.
pub async fn step(session: &mut Session, sim: &mut Sim, sent: &mut Sent) -> SessionAction {
    let observation = observe(sim);
    sent.add(&observation);
    let reply = session.act(observation).await.unwrap();
    let action = reply.actions[0].values.clone();
    sim.step(action.as_slice().try_into().unwrap());
    sent.actions.extend(action);
    reply
}

/// A simulator without a limit on its steps.
pub fn endless() -> Sim {
    Sim::new(SimTask::PickCube, gleaner_sim::SimConfig { max_steps: u32::MAX, ..lab::sim_config() }, 99)
}

/// The number of messages of a topic in an episode.
pub fn messages(reading: &Reading, topic: &str) -> u64 {
    reading.report.topics.iter().filter(|one| one.topic == topic).map(|one| one.messages).sum()
}

/// Removes the last bytes of a file, as a loss of power can.
pub fn tear(file: &Path) {
    let file = std::fs::File::options().write(true).open(file).unwrap();
    file.set_len(file.metadata().unwrap().len() - 7).unwrap();
}
