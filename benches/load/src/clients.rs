//! Well-behaved clients that upload, query or act, each on its own connection and at its own rate.

use std::path::{Path, PathBuf};
use std::time::Duration;

use gleaner_bench_serving::{
    Result,
    connection::Connection,
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
use crate::stats::{CallKind, Stats};

/// Steps of an uploaded recording.
const STEPS: usize = 6;

/// Starts every client; they stop on drop.
pub(crate) async fn start(
    options: &Options,
    url: &str,
    prepared: &Prepared,
    folder: &Path,
    stats: &Stats,
) -> Result<JoinSet<()>> {
    let mut clients = JoinSet::new();
    let request = ListEpisodesRequest { task: prepared.spec.name.clone(), ..ListEpisodesRequest::default() };
    let episodes = prepared.client.episodes().list_episodes(request).await?.into_inner().episodes;
    let known: Vec<String> = episodes.into_iter().map(|episode| episode.id).collect();
    for number in 0..options.uploaders {
        let (client, folder) = (Client::connect(url, None).await?, folder.to_owned());
        let uploader = Uploader { client, spec: prepared.spec.clone(), folder, number, steps: steps(7, STEPS) };
        clients.spawn(uploader.run(ticks_of(options.upload_every, number, options.uploaders), stats.clone()));
    }
    for number in 0..options.queriers {
        let querier = Querier {
            client: Client::connect(url, None).await?,
            task: prepared.spec.name.clone(),
            known: known.clone(),
        };
        clients.spawn(querier.run(ticks_of(options.query_every, number, options.queriers), stats.clone()));
    }
    let scene = scene(prepared)?;
    for number in 0..options.robots {
        let connection = Connection::open(&prepared.address).await?;
        clients.spawn(act(
            connection,
            scene.clone(),
            ticks_of(options.observe_every, number, options.robots),
            stats.clone(),
        ));
    }
    Ok(clients)
}

/// The observations of the robots, one step after the other.
pub(crate) fn scene(prepared: &Prepared) -> Result<Vec<Observation>> {
    prepared.steps.iter().map(|step| observe(&prepared.spec, step, Images::Jpeg)).collect()
}

/// Ticks at this interval in seconds. The clients of a kind start one after the other.
fn ticks_of(seconds: f64, number: u32, of: u32) -> Interval {
    let period = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::from_secs(1)).max(Duration::from_millis(1));
    let first = tokio::time::Instant::now() + period * number / of.max(1);
    let mut ticks = interval_at(first, period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}

/// Runs a session with one observation a tick.
pub(crate) async fn act(mut connection: Connection, scene: Vec<Observation>, mut ticks: Interval, stats: Stats) {
    for observation in scene.iter().cycle() {
        ticks.tick().await;
        let now = stats.now();
        let reply = connection.act(observation).await;
        let lost = reply.is_err();
        stats.count(CallKind::Act, now, reply);
        if lost {
            break;
        }
    }
}

struct Querier {
    client: Client,
    task: String,
    known: Vec<String>,
}

impl Querier {
    async fn run(self, mut ticks: Interval, stats: Stats) {
        for turn in 0.. {
            ticks.tick().await;
            let now = stats.now();
            stats.count(CallKind::Query, now, self.query(turn).await);
        }
    }

    async fn query(&self, number: usize) -> Result<()> {
        match number % 4 {
            0 => drop(self.client.tasks().list_tasks(ListTasksRequest::default()).await?),
            1 => {
                let (task, page_size) = (self.task.clone(), 50);
                let request = ListEpisodesRequest { task, page_size, ..ListEpisodesRequest::default() };
                drop(self.client.episodes().list_episodes(request).await?);
            }
            2 => {
                let request = ListPoliciesRequest { task: self.task.clone(), ..Default::default() };
                drop(self.client.policies().list_policies(request).await?);
            }
            _ => {
                let episode_id = self.known.get(number % self.known.len().max(1)).cloned().unwrap_or_default();
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
    async fn run(mut self, mut ticks: Interval, stats: Stats) {
        for turn in 0.. {
            ticks.tick().await;
            let now = stats.now();
            stats.count(CallKind::Upload, now, self.upload(turn).await);
        }
    }

    /// Uploads a recording whose content differs from all others.
    async fn upload(&mut self, turn: u16) -> Result<()> {
        if let Some(values) = self.steps.first_mut().map(|step| &mut step.proprioception)
            && let [first, second, ..] = values.as_mut_slice()
        {
            (*first, *second) = (f32::from(turn), f32::from(u16::try_from(self.number)?));
        }
        let path = self.folder.join(format!("upload-{}.mcap", self.number));
        // On another thread, so that the times of other clients do not include the encoding.
        let (spec, steps, out) = (self.spec.clone(), self.steps.clone(), path.clone());
        spawn_blocking(move || record(&spec, &steps, &out)).await??;
        let label = UploadLabel { outcome: Outcome::Unknown, cohort: "load".to_owned(), author: "load".to_owned() };
        self.client.upload(&self.spec.name, &path, &label, |_| ()).await?;
        Ok(())
    }
}
