//! An experiment's recordings: of the simulator, made once and kept in its folder, or made elsewhere. On the server they
//! are under a separate task.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use gleaner_client::{Client, ClientError, LabelledFile, PushItem, Pushed, UploadLabel, read_labels};
use gleaner_proto::v1::{CreateTaskRequest, GetTaskRequest, Outcome};
use gleaner_sim::LABELS;
use serde::{Deserialize, Serialize};

use super::collection::Collection;
use super::mark_rows::FolderMarks;
use super::source::Source;
use crate::cmd::{push, record};
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::quality::Mark;

// Written last: beside it, recordings are complete.
const COMPLETE: &str = "complete";
// Results do not depend on the order of uploads: snapshots are in the order of digests, reports in that of recordings.
const PARALLEL_UPLOADS: usize = 4;

/// One recording that the server holds.
#[derive(Clone, Debug)]
pub(crate) struct Recording {
    /// Its place among the recordings, in the order in which they were made.
    pub(crate) place: usize,
    pub(crate) cohort: String,
    pub(crate) success: bool,
    pub(crate) steps: u64,
    pub(crate) mark: Mark,
}

/// How many episodes a cohort has, and how they ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct CohortCount {
    pub(crate) cohort: String,
    pub(crate) agent: String,
    pub(crate) episodes: u64,
    pub(crate) steps: u64,
    pub(crate) successes: u64,
}

/// Every recording, by the episode it is on the server.
#[derive(Debug)]
pub(crate) struct Recordings {
    pub(crate) by_episode: HashMap<String, Recording>,
    /// Whether it is known from which step on each went wrong; otherwise no recording has a mark.
    pub(crate) are_marked: bool,
    /// Bytes that this run sent, and the time that it took.
    pub(crate) sent: (u64, Duration),
}

impl Recordings {
    /// Records the missing recordings, each collection in its folder, and pushes those that the server lacks.
    pub(crate) async fn ready(context: &Context, client: &Client, all: &[(&Collection, PathBuf)]) -> Result<Self> {
        let mut ready = Self { by_episode: HashMap::new(), are_marked: true, sent: (0, Duration::ZERO) };
        for (collection, folder) in all {
            ready.add(context, client, folder, collection).await?;
        }
        Ok(ready)
    }

    async fn add(&mut self, context: &Context, client: &Client, folder: &Path, collection: &Collection) -> Result<()> {
        recorded(context, folder, collection).await?;
        create_task(client, collection).await?;
        let folder = match &collection.source {
            Source::Simulated(_) => folder,
            Source::Folder(elsewhere) => &elsewhere.path,
        };
        let files = read_labels(&folder.join(LABELS))?;
        let successes: HashMap<_, _> =
            files.iter().map(|file| (file.path.clone(), file.outcome == Outcome::Success)).collect();
        let are_marked = collection.source.is_marked();
        // Before the uploads, which take a while.
        let mut marks = if are_marked { Some(FolderMarks::read(folder)?) } else { None };
        let pushed = pushed(context, client, collection, files).await?;
        // By the pushed file, whatever name its content may have on the server.
        let episodes = pushed.results.iter().filter_map(|item| Some((&item.path, &item.result.as_ref().ok()?.episode)));
        let before = self.by_episode.len();
        for (place, (path, episode)) in episodes.enumerate() {
            let mark = marks.as_mut().map_or_else(|| Ok(Mark::default()), |marks| marks.take(path))?;
            let success = successes.get(path).copied().unwrap_or_default();
            let (cohort, steps) = (episode.cohort.clone(), episode.steps);
            let recording = Recording { place: before + place, cohort, success, steps, mark };
            self.by_episode.insert(episode.id.clone(), recording);
        }
        self.are_marked &= are_marked;
        self.sent = (self.sent.0 + pushed.sent_bytes(), self.sent.1 + pushed.wall);
        Ok(())
    }

    /// Each cohort's episodes, experts first.
    pub(crate) fn counts(&self, source: &Source) -> Vec<CohortCount> {
        let count = |(cohort, agent): (&str, String)| {
            let of_cohort = || self.by_episode.values().filter(|recording| recording.cohort == cohort);
            CohortCount {
                cohort: cohort.to_owned(),
                agent,
                episodes: of_cohort().count() as u64,
                steps: of_cohort().map(|recording| recording.steps).sum(),
                successes: of_cohort().filter(|recording| recording.success).count() as u64,
            }
        };
        source.agents().into_iter().map(count).collect()
    }
}

/// Records the missing recordings of the simulator.
pub(super) async fn recorded(context: &Context, folder: &Path, collection: &Collection) -> Result<()> {
    let Source::Simulated(set) = &collection.source else { return Ok(()) };
    let complete = folder.join(COMPLETE);
    if complete.exists() {
        return Ok(());
    }
    record::record(context, folder, set.clone()).await?;
    Ok(std::fs::write(&complete, b"").map_err(ClientError::io(complete))?)
}

async fn create_task(client: &Client, collection: &Collection) -> Result<()> {
    let name = collection.task.clone();
    match client.tasks().get_task(GetTaskRequest { task: name.clone() }).await {
        Ok(_) => return Ok(()),
        Err(status) if status.code() == tonic::Code::NotFound => {}
        Err(status) => return Err(status.into()),
    }
    let mut task = collection.source.spec();
    task.name = name;
    client
        .tasks()
        .create_task(CreateTaskRequest { spec: Some(gleaner_core::proto::task::spec_to_proto(task.clone())) })
        .await?;
    Ok(())
}

async fn pushed(
    context: &Context,
    client: &Client,
    collection: &Collection,
    files: Vec<LabelledFile>,
) -> Result<Pushed> {
    let author = match &collection.source {
        Source::Simulated(_) => "simulator",
        Source::Folder(_) => "experiment",
    };
    let item = |file: LabelledFile| PushItem {
        path: file.path,
        parts: Vec::new(),
        task: collection.task.clone(),
        label: UploadLabel { outcome: file.outcome, cohort: file.cohort, author: author.into() },
    };
    let items = files.into_iter().map(item).collect();
    let pushed = push::push(context, client, items, PARALLEL_UPLOADS).await;
    if let Some((item, error)) = pushed.failures().next() {
        return Err(Failure::message(format!("{} was rejected: {error}", item.path.display())));
    }
    Ok(pushed)
}

/// The recording of an episode that a job used.
pub(crate) fn of_episode<'a>(recordings: &'a Recordings, episode_id: &str) -> Result<&'a Recording> {
    present(recordings.by_episode.get(episode_id), "an episode that this experiment recorded")
}
