//! An experiment's recordings: made once, kept in its folder, on the server under a separate task.

use std::collections::HashMap;
use std::path::Path;
use std::time::Duration;

use gleaner_client::{Client, ClientError, PushItem, Pushed, UploadLabel, read_labels};
use gleaner_proto::v1::{CreateTaskRequest, GetTaskRequest};
use gleaner_sim::{LABELS, MARKS};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::file::Experiment;
use crate::cmd::{push, record};
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::quality::Mark;

// Written last: beside it, recordings are complete.
const COMPLETE: &str = "complete";
// Results do not depend on the order of uploads: snapshots are in the order of digests, reports in that of recordings.
const PARALLEL_UPLOADS: usize = 4;

/// One recording's row of the marks.
#[derive(Clone, Debug, Deserialize)]
struct Row {
    file: String,
    success: bool,
    went_wrong: Option<u32>,
}

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
    /// Bytes that this run sent, and the time that it took.
    pub(crate) sent: (u64, Duration),
}

impl Recordings {
    /// Records the missing recordings, and pushes those that the server lacks.
    pub(crate) async fn ready(context: &Context, client: &Client, folder: &Path, plan: &Experiment) -> Result<Self> {
        recorded(context, folder, plan).await?;
        create_task(client, plan).await?;
        let pushed = pushed(context, client, folder, plan).await?;
        let marks = marks(folder)?;
        // By the pushed file, whatever name its content may have on the server.
        let episodes = pushed.results.iter().filter_map(|item| {
            Some((item.path.file_name()?.to_string_lossy().into_owned(), &item.result.as_ref().ok()?.episode))
        });
        let mut by_episode = HashMap::new();
        for (place, (file, episode)) in episodes.enumerate() {
            let row = marks.get(&file);
            let row =
                row.ok_or_else(|| Failure::message(format!("{file} has no row in {}", folder.join(MARKS).display())))?;
            let mark = Mark { went_wrong: row.went_wrong };
            let (cohort, steps) = (episode.cohort.clone(), episode.steps);
            by_episode.insert(episode.id.clone(), Recording { place, cohort, success: row.success, steps, mark });
        }
        Ok(Self { by_episode, sent: (pushed.sent_bytes(), pushed.wall) })
    }

    /// Each cohort's episodes, in the file's order.
    pub(crate) fn counts(&self, plan: &Experiment) -> Vec<CohortCount> {
        let count = |cohort: &gleaner_sim::Cohort| {
            let of_cohort = || self.by_episode.values().filter(|recording| recording.cohort == cohort.name);
            CohortCount {
                cohort: cohort.name.clone(),
                agent: cohort.agent.to_string(),
                episodes: of_cohort().count() as u64,
                steps: of_cohort().map(|recording| recording.steps).sum(),
                successes: of_cohort().filter(|recording| recording.success).count() as u64,
            }
        };
        plan.recordings.cohorts.iter().map(count).collect()
    }
}

/// Records the missing recordings.
pub(super) async fn recorded(context: &Context, folder: &Path, plan: &Experiment) -> Result<()> {
    let complete = folder.join(COMPLETE);
    if complete.exists() {
        return Ok(());
    }
    record::record(context, folder, plan.recordings.clone()).await?;
    Ok(std::fs::write(&complete, b"").map_err(ClientError::io(complete))?)
}

async fn create_task(client: &Client, plan: &Experiment) -> Result<()> {
    let name = plan.task.clone();
    match client.tasks().get_task(GetTaskRequest { task: name.clone() }).await {
        Ok(_) => return Ok(()),
        Err(status) if status.code() == tonic::Code::NotFound => {}
        Err(status) => return Err(status.into()),
    }
    let mut task = gleaner_sim::task_spec(plan.recordings.task, &plan.recordings.config);
    task.name = name;
    client
        .tasks()
        .create_task(CreateTaskRequest { spec: Some(gleaner_core::proto::task::spec_to_proto(task.clone())) })
        .await?;
    Ok(())
}

async fn pushed(context: &Context, client: &Client, folder: &Path, plan: &Experiment) -> Result<Pushed> {
    let item = |file: gleaner_client::LabelledFile| PushItem {
        path: file.path,
        parts: Vec::new(),
        task: plan.task.clone(),
        label: UploadLabel { outcome: file.outcome, cohort: file.cohort, author: "simulator".into() },
    };
    let items = read_labels(&folder.join(LABELS))?.into_iter().map(item).collect();
    let pushed = push::push(context, client, items, PARALLEL_UPLOADS).await;
    if let Some((item, error)) = pushed.failures().next() {
        return Err(Failure::message(format!("{} was rejected: {error}", item.path.display())));
    }
    Ok(pushed)
}

fn marks(folder: &Path) -> Result<HashMap<String, Row>> {
    let rows: Vec<Row> = rows(&folder.join(MARKS))?;
    Ok(rows.into_iter().map(|row| (row.file.clone(), row)).collect())
}

/// The rows of a CSV file with a header.
pub(super) fn rows<R: DeserializeOwned>(path: &Path) -> Result<Vec<R>> {
    let wrong = |error: csv::Error| Failure::message(format!("{}: {error}", path.display()));
    let mut reader = csv::Reader::from_path(path).map_err(wrong)?;
    reader.deserialize().collect::<std::result::Result<_, _>>().map_err(wrong)
}

/// The recording of an episode that a job used.
pub(crate) fn of_episode<'a>(recordings: &'a Recordings, episode_id: &str) -> Result<&'a Recording> {
    present(recordings.by_episode.get(episode_id), "an episode that this experiment recorded")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_read_with_their_gaps() {
        let folder = tempfile::tempdir().unwrap();
        let text = "file,agent,grade,seed,success,went_wrong,departure\n\
                    a.mcap,expert,0,0,true,,\nb.mcap,noise,1,1,false,3,0 0.5 2\n";
        std::fs::write(folder.path().join(MARKS), text).unwrap();
        let marks = marks(folder.path()).unwrap();
        assert_eq!((marks["a.mcap"].went_wrong, marks["b.mcap"].went_wrong), (None, Some(3)));
        assert!(marks["a.mcap"].success && !marks["b.mcap"].success);
    }
}
