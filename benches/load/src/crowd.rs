//! Good clients: some upload, some ask, some act, each on a connection of its own and at a pace of its own.

use std::path::{Path, PathBuf};
use std::time::Duration;

use gleaner_bench_serving::{
    Result,
    door::Door,
    prepare::{Prepared, record},
    scene::{Images, Step, observe, steps},
};
use gleaner_client::{Client, UploadLabel};
use gleaner_proto::v1::{
    GetEpisodeRequest, ListEpisodesRequest, ListPoliciesRequest, ListTasksRequest, Observation, Outcome,
};
use gleaner_recording::TaskSpec;
use tokio::task::{JoinSet, spawn_blocking};
use tokio::time::{Interval, MissedTickBehavior, interval_at};

use crate::cli::Options;
use crate::tally::{Doing, Tally};

/// Steps of an uploaded recording.
const STEPS: usize = 6;

/// Sets every client to work; dropped, they stop.
pub(crate) async fn gather(
    options: &Options,
    url: &str,
    prepared: &Prepared,
    folder: &Path,
    tally: &Tally,
) -> Result<JoinSet<()>> {
    let mut crowd = JoinSet::new();
    let request = ListEpisodesRequest { task: prepared.spec.name.clone(), ..ListEpisodesRequest::default() };
    let episodes = prepared.client.episodes().list_episodes(request).await?.into_inner().episodes;
    let known: Vec<String> = episodes.into_iter().map(|episode| episode.id).collect();
    for number in 0..options.uploaders {
        let (client, folder) = (Client::connect(url, None).await?, folder.to_owned());
        let uploader = Uploader { client, spec: prepared.spec.clone(), folder, number, steps: steps(7, STEPS) };
        crowd.spawn(uploader.work(pace(options.upload_every, number, options.uploaders), tally.clone()));
    }
    for number in 0..options.askers {
        let asker =
            Asker { client: Client::connect(url, None).await?, task: prepared.spec.name.clone(), known: known.clone() };
        crowd.spawn(asker.work(pace(options.ask_every, number, options.askers), tally.clone()));
    }
    let scene = scene(prepared)?;
    for number in 0..options.robots {
        let door = Door::open(&prepared.address).await?;
        crowd.spawn(act(door, scene.clone(), pace(options.observe_every, number, options.robots), tally.clone()));
    }
    Ok(crowd)
}

/// What robots see, one step after the other.
pub(crate) fn scene(prepared: &Prepared) -> Result<Vec<Observation>> {
    prepared.steps.iter().map(|step| observe(&prepared.spec, step, Images::Jpeg)).collect()
}

/// Ticks this many seconds apart. Clients of a kind do not all begin at once.
fn pace(seconds: f64, number: u32, of: u32) -> Interval {
    let period = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::from_secs(1)).max(Duration::from_millis(1));
    let first = tokio::time::Instant::now() + period * number / of.max(1);
    let mut ticks = interval_at(first, period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}

/// A robot with a session: one observation a tick.
pub(crate) async fn act(mut door: Door, scene: Vec<Observation>, mut ticks: Interval, tally: Tally) {
    for observation in scene.iter().cycle() {
        ticks.tick().await;
        let now = tally.now();
        let answer = door.act(observation).await;
        let lost = answer.is_err();
        tally.count(Doing::Acting, now, answer);
        if lost {
            break;
        }
    }
}

struct Asker {
    client: Client,
    task: String,
    known: Vec<String>,
}

impl Asker {
    async fn work(self, mut ticks: Interval, tally: Tally) {
        for turn in 0.. {
            ticks.tick().await;
            let now = tally.now();
            tally.count(Doing::Asking, now, self.ask(turn).await);
        }
    }

    async fn ask(&self, turn: usize) -> Result<()> {
        match turn % 4 {
            0 => drop(self.client.tasks().list_tasks(ListTasksRequest::default()).await?),
            1 => {
                let (task, page_size) = (self.task.clone(), 50);
                let request = ListEpisodesRequest { task, page_size, ..ListEpisodesRequest::default() };
                drop(self.client.episodes().list_episodes(request).await?);
            }
            2 => {
                let request = ListPoliciesRequest { task: self.task.clone() };
                drop(self.client.policies().list_policies(request).await?);
            }
            _ => {
                let episode_id = self.known.get(turn % self.known.len().max(1)).cloned().unwrap_or_default();
                drop(self.client.episodes().get_episode(GetEpisodeRequest { episode_id }).await?);
            }
        }
        Ok(())
    }
}

struct Uploader {
    client: Client,
    spec: TaskSpec,
    folder: PathBuf,
    number: u32,
    steps: Vec<Step>,
}

impl Uploader {
    async fn work(mut self, mut ticks: Interval, tally: Tally) {
        for turn in 0.. {
            ticks.tick().await;
            let now = tally.now();
            tally.count(Doing::Uploading, now, self.upload(turn).await);
        }
    }

    /// A recording like no other.
    async fn upload(&mut self, turn: u16) -> Result<()> {
        if let Some(values) = self.steps.first_mut().map(|step| &mut step.proprioception)
            && let [first, second, ..] = values.as_mut_slice()
        {
            (*first, *second) = (f32::from(turn), f32::from(u16::try_from(self.number)?));
        }
        let path = self.folder.join(format!("upload-{}.mcap", self.number));
        // Elsewhere, or every other client would wait for the encoding and call it the server's time.
        let (spec, steps, out) = (self.spec.clone(), self.steps.clone(), path.clone());
        spawn_blocking(move || record(&spec, &steps, &out)).await??;
        let label = UploadLabel { outcome: Outcome::Unknown, cohort: "load".to_owned(), author: "load".to_owned() };
        self.client.upload(&self.spec.name, &path, &label, |_| ()).await?;
        Ok(())
    }
}
