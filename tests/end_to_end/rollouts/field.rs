//! What tests of recorded rollouts share: a server with a scored deployment, and runs whose every byte is known.

use std::{
    path::Path,
    sync::{Arc, Weak},
    time::Duration,
};

use gleaner_client::Session;
use gleaner_proto::v1::*;
use gleaner_recording::{Reading, read_episode};
use gleaner_sim::{Sim, Task as SimTask};
use tokio::sync::Mutex;

use crate::{api::Api, lab, live::observe, server::TestServer};

pub const NAME: &str = "pick_cube@rollouts";
/// What is waited for below takes no longer.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// A server with a policy and a score run deployed together. Not the other tests' one: episodes are added here.
pub struct Field {
    pub server: TestServer,
    pub experts: Vec<String>,
}

pub async fn field() -> Arc<Field> {
    static SHARED: Mutex<Weak<Field>> = Mutex::const_new(Weak::new());
    let mut held = SHARED.lock().await;
    if let Some(field) = held.upgrade() {
        return field;
    }
    let server = TestServer::start().await;
    let mut api = Api::connect(&server).await;
    let episodes = lab::set_up(&mut api).await;
    let encoder = api.succeed(lab::TASK, lab::pretrain(2)).await.result_id;
    let score_run_id = api.succeed(lab::TASK, lab::score(&encoder)).await.result_id;
    let policy_id = api.succeed(lab::TASK, lab::train(train_spec::Data::ExpertsOf(encoder), 2)).await.result_id;
    api.policies.deploy(DeployRequest { name: NAME.into(), policy_id, score_run_id }).await.unwrap();
    let experts = episodes.into_iter().filter(|one| one.outcome() == Outcome::Success).map(|one| one.id).collect();
    let field = Arc::new(Field { server, experts });
    *held = Arc::downgrade(&field);
    field
}

pub fn recorded(cohort: &str) -> SessionOpen {
    SessionOpen { deployment: NAME.into(), record: true, cohort: cohort.into(), ..SessionOpen::default() }
}

/// The episodes of a cohort, as soon as there are so many.
pub async fn episodes(api: &mut Api, cohort: &str, many: usize) -> Vec<Episode> {
    let request = ListEpisodesRequest { task: lab::TASK.into(), cohort: cohort.into(), ..Default::default() };
    let listing = async {
        loop {
            let listed = api.episodes.list_episodes(request.clone()).await.unwrap().into_inner().episodes;
            if listed.len() >= many {
                return listed;
            }
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(PATIENCE, listing).await.expect("the episode is not there")
}

/// Downloads an episode and reads it as any lab would.
pub async fn read(api: &mut Api, episode: &str) -> Reading {
    let request = DownloadEpisodeRequest { episode_id: episode.to_owned() };
    let mut chunks = api.episodes.download_episode(request).await.unwrap().into_inner();
    let mut bytes = Vec::new();
    while let Some(chunk) = chunks.message().await.unwrap() {
        bytes.extend_from_slice(&chunk.data);
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("rollout.mcap"), bytes).unwrap();
    let spec = gleaner_sim::task_spec(SimTask::PickCube, &lab::sim_config());
    read_episode(&folder.path().join("rollout.mcap"), &spec).unwrap()
}

/// Of a lock-step run: what was seen, and what was done then.
#[derive(Default)]
pub struct Sent {
    pub stamps: Vec<i64>,
    pub frames: Vec<u8>,
    pub proprioception: Vec<f32>,
    pub actions: Vec<f32>,
}

impl Sent {
    pub fn see(&mut self, observation: &Observation) {
        self.stamps.push(observation.stamp_ns);
        self.proprioception.extend(&observation.proprioception);
        for camera in &observation.cameras {
            for image in [&camera.color, &camera.depth].into_iter().flatten() {
                self.frames.extend_from_slice(&image.data);
            }
        }
    }

    pub fn equals(&self, reading: &Reading) {
        let steps = self.stamps.len();
        assert_eq!(reading.episode.stamps(), self.stamps);
        assert!(reading.episode.frames().as_ref() == self.frames, "the images of {steps} steps are others");
        assert_eq!(reading.episode.proprioception(), self.proprioception);
        assert_eq!(reading.episode.action(), self.actions);
    }
}

/// One step of a lock-step run; gives its answer and leaves the simulator after it.
pub async fn step(session: &mut Session, sim: &mut Sim, sent: &mut Sent) -> SessionAction {
    let observation = observe(sim);
    sent.see(&observation);
    let answer = session.act(observation).await.unwrap();
    let action = answer.actions[0].values.clone();
    sim.step(action.as_slice().try_into().unwrap());
    sent.actions.extend(action);
    answer
}

/// A scene that goes on for as long as a test likes.
pub fn endless() -> Sim {
    Sim::new(SimTask::PickCube, gleaner_sim::SimConfig { max_steps: u32::MAX, ..lab::sim_config() }, 99)
}

pub fn messages(reading: &Reading, topic: &str) -> u64 {
    reading.report.topics.iter().filter(|one| one.topic == topic).map(|one| one.messages).sum()
}

/// Cuts the last bytes off, as a disk may that has lost its power.
pub fn tear(file: &Path) {
    let file = std::fs::File::options().write(true).open(file).unwrap();
    file.set_len(file.metadata().unwrap().len() - 7).unwrap();
}
