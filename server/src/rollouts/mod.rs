//! Rollouts: recorded sessions become episodes of their task, however they end.
//!
//! A robot never waits for the disk: its session queues events, and a task per recording writes them and passes the
//! file to `ingest` like an upload. Recordings left by a crash are stored at the next start. Must not depend on models or
//! wire types.

mod event;
mod file;
mod keep;
mod recorder;
mod recover;
mod sidecar;
mod steps;
#[cfg(test)]
mod tests;
mod writer;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use gleaner_recording::{TaskSpec, memory_per_step};
use tokio::{sync::mpsc, time::Instant};
use tokio_util::{sync::CancellationToken, task::TaskTracker};
use tracing::Instrument as _;

use self::{
    event::{Ending, Event},
    sidecar::{RolloutFiles, RolloutSidecar},
    writer::{Limits, RolloutWriter},
};
pub(crate) use self::{
    recorder::{ObservationCounts, Recorder},
    sidecar::SessionInfo,
};
use crate::{
    blobs::{Blobs, sync_folder},
    blocking::off_runtime,
    config::ServeConfig,
    domain::{
        episode::Outcome,
        id::{EpisodeId, SessionId},
        task::Task,
    },
    error::{Error, Kind, Result},
    ingest::Ingest,
};

/// The most events written in one batch.
const MANY: usize = 256;
/// How long a stopping server waits for recordings to be stored; the next start stores the others.
const PATIENCE: Duration = Duration::from_secs(20);
/// The interval of retries while the disk has no room for a recording.
#[cfg(not(test))]
const AGAIN_AFTER: Duration = Duration::from_secs(30);
#[cfg(test)]
const AGAIN_AFTER: Duration = Duration::from_millis(5);

/// The recordings of running sessions; clones share them.
#[derive(Debug, Clone)]
pub struct Rollouts(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    ingest: Ingest,
    folder: PathBuf,
    /// The limits of an inspection and of an upload.
    memory_bytes: u64,
    upload_bytes: u64,
    tasks: TaskTracker,
    stopping: CancellationToken,
}

impl Rollouts {
    /// Creates the folder and starts to store recordings that an earlier run has left there.
    ///
    /// # Errors
    /// Internal when the folder cannot be created.
    pub fn open(config: &ServeConfig, ingest: Ingest) -> Result<Self> {
        let rollouts = Self::new(config, ingest);
        rollouts.begin_storing()?;
        Ok(rollouts)
    }

    /// The recordings of a standby, which has none until it leads.
    pub(crate) fn new(config: &ServeConfig, ingest: Ingest) -> Self {
        Self(Arc::new(Inner {
            ingest,
            folder: config.data_dir.join("rollouts"),
            memory_bytes: config.limits.inspect_memory_bytes,
            upload_bytes: config.limits.max_upload_bytes,
            tasks: TaskTracker::new(),
            stopping: CancellationToken::new(),
        }))
    }

    /// Creates the folder and starts to store recordings that an earlier server has left there.
    ///
    /// # Errors
    /// As [`Rollouts::open`].
    pub(crate) fn begin_storing(&self) -> Result<()> {
        let folder = &self.0.folder;
        std::fs::create_dir_all(folder).map_err(sidecar::fault("making", folder))?;
        // Without the entry in its parent, a folder is lost with everything synced in it.
        sync_folder(folder.parent().unwrap_or(folder))?;
        // In the background: neither a robot nor the start waits for it.
        let left = self.left()?;
        let recovering = self.clone();
        self.0.tasks.spawn(async move { recovering.recover(left).await });
        Ok(())
    }

    /// Records a session that begins now. The file is created with the first step.
    ///
    /// # Errors
    /// Exhausted when the disk is nearly full; Precondition or Unavailable on a standby, which writes no episodes.
    pub(crate) fn begin(&self, session: SessionInfo, task: &Task) -> Result<Recorder> {
        self.0.ingest.expect_leader()?;
        self.0
            .ingest
            .blobs()
            .expect_room(0)
            .map_err(|error| Error::exhausted(format!("{}; or open the session without recording", error.message())))?;
        let (sender, events) = mpsc::unbounded_channel();
        let files = self.files(&session.session_id);
        let span = tracing::info_span!("rollout", session.id = %session.session_id);
        let sidecar = RolloutSidecar { session, outcome: Outcome::Unknown, steps: None };
        let writer = RolloutWriter::new(files.clone(), sidecar, task.spec.clone(), self.limits(&task.spec));
        let rollouts = self.clone();
        self.0.tasks.spawn(async move { rollouts.record(events, writer, files).await }.instrument(span));
        Ok(Recorder::new(sender, task.spec.action_size()))
    }

    /// Waits for recordings to be stored, up to a limit; the next start stores the others.
    pub async fn stop(&self) {
        self.0.stopping.cancel();
        self.0.tasks.close();
        if tokio::time::timeout(PATIENCE, self.0.tasks.wait()).await.is_err() {
            tracing::warn!("some recordings of sessions are not stored yet; the next start stores them");
        }
    }

    /// Writes events until the session ends, then stores the recording.
    async fn record(&self, mut events: mpsc::UnboundedReceiver<Event>, writer: RolloutWriter, files: RolloutFiles) {
        let (ending, done, writer) = match write_down(&mut events, writer, self.0.ingest.blobs()).await {
            Ok((Some((ending, done)), writer)) => (ending, Some(done), Ok(writer)),
            // Its recorder was dropped without an end.
            Ok((None, writer)) => (broken_off(), None, Ok(writer)),
            Err(error) => (broken_off(), None, Err(error)),
        };
        let kept = self.end(writer, ending, &files).await;
        match &kept {
            Ok(Some(episode)) => tracing::info!(episode.id = %episode, "session stored as an episode"),
            Ok(None) => tracing::info!("a session of fewer than two steps is not stored"),
            Err(error) => {
                tracing::error!(error = error as &dyn std::error::Error, "storing a session's recording failed")
            }
        }
        let later = matches!(&kept, Err(error) if passes(error));
        if let Some(done) = done {
            // The session may be gone.
            let _ = done.send(kept);
        }
        if later {
            // In the background: if the server stops first, the next start stores it.
            let _: Option<()> = self.0.stopping.run_until_cancelled(self.keep_later(&files)).await;
        }
    }

    /// Stores a recording once the disk has room for it, and the database and the store of blobs answer.
    async fn keep_later(&self, files: &RolloutFiles) {
        loop {
            tokio::time::sleep(AGAIN_AFTER).await;
            if self.0.ingest.blobs().room_for(0).await.is_err() {
                continue;
            }
            match self.keep(files).await {
                Err(error) if passes(&error) => {}
                Ok(_) => return tracing::info!("session stored at a later try"),
                Err(error) => return tracing::error!(%error, "storing a session's recording failed"),
            }
        }
    }

    async fn end(
        &self,
        writer: Result<RolloutWriter>,
        ending: Ending,
        files: &RolloutFiles,
    ) -> Result<Option<EpisodeId>> {
        if let Ok(writer) = writer
            && !off_runtime("recording a session", move || writer.end(&ending)).await?
        {
            return Ok(None);
        }
        self.keep(files).await
    }

    fn files(&self, session: &SessionId) -> RolloutFiles {
        RolloutFiles::new(&self.0.folder, session.as_str())
    }

    fn folder(&self) -> &Path {
        &self.0.folder
    }

    /// Below the limits of an inspection and an upload, because a refused recording is lost.
    fn limits(&self, spec: &TaskSpec) -> Limits {
        let step = u64::try_from(memory_per_step(spec)).unwrap_or(u64::MAX);
        let steps = (self.0.memory_bytes / 4 * 3).checked_div(step).unwrap_or(u64::MAX);
        Limits { steps, bytes: self.0.upload_bytes / 16 * 15 }
    }
}

/// Whether a recording that could not be stored may be at a later try: no client can repeat it.
fn passes(error: &Error) -> bool {
    matches!(error.kind(), Kind::Exhausted | Kind::Unavailable)
}

type Ended = (Ending, tokio::sync::oneshot::Sender<Result<Option<EpisodeId>>>);

/// Writes events until the session ends or its recorder is dropped. The writer moves to blocking threads and back.
async fn write_down(
    incoming: &mut mpsc::UnboundedReceiver<Event>,
    mut writer: RolloutWriter,
    blobs: &Blobs,
) -> Result<(Option<Ended>, RolloutWriter)> {
    let mut events = Vec::new();
    loop {
        let sync_at = writer.sync_at();
        let synced = async {
            match sync_at {
                Some(at) => tokio::time::sleep_until(Instant::from_std(at)).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            biased;
            () = synced => {
                let room = blobs.room_for(0).await;
                writer = off_runtime("recording a session", move || {
                    writer.sync();
                    room.unwrap_or_else(|error| writer.stop(&error));
                    Ok(writer)
                })
                .await?;
            }
            taken = incoming.recv_many(&mut events, MANY) => {
                if taken == 0 {
                    return Ok((None, writer));
                }
                let batch = std::mem::take(&mut events);
                let (back, ended) = off_runtime("recording a session", move || Ok(write(writer, batch))).await?;
                writer = back;
                if ended.is_some() {
                    return Ok((ended, writer));
                }
            }
        }
    }
}

fn write(mut writer: RolloutWriter, events: Vec<Event>) -> (RolloutWriter, Option<Ended>) {
    for event in events {
        match event {
            Event::Step(step) => writer.step(&step),
            Event::Note(note) => writer.note(note),
            Event::End(ending, done) => return (writer, Some((ending, done))),
        }
    }
    (writer, None)
}

/// The end of a session whose recorder was dropped.
fn broken_off() -> Ending {
    let (outcome, how) = (Outcome::Unknown, "aborted".to_owned());
    Ending { outcome, how, answered: 0, dropped: 0, missed: 0, unscored: None, left_out: 0 }
}
