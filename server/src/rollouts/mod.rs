//! Rollouts: sessions that are recorded become episodes of their task, however they end.
//!
//! A robot never waits for the disk: its session leaves what happens in a queue, and a task of the recording's own
//! writes it down and stores it by the door that uploads use. What a crash leaves is kept at the next start. Knows no
//! model and no wire type.

mod about;
mod event;
mod file;
mod keep;
mod recorder;
mod recover;
mod steps;
mod tape;
#[cfg(test)]
mod tests;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use gleaner_recording::{TaskSpec, frame_bytes_per_step};
use tokio::{sync::mpsc, time::Instant};
use tokio_util::{sync::CancellationToken, task::TaskTracker};
use tracing::Instrument as _;

pub(crate) use self::{
    about::About,
    recorder::{Recorder, Tally},
};
use self::{
    about::{Place, Slip},
    event::{Ending, Event},
    tape::{Limits, Tape},
};
use crate::{
    blobs::{Blobs, sync_folder},
    config::ServeConfig,
    domain::{
        episode::Outcome,
        id::{EpisodeId, SessionId},
        task::Task,
    },
    error::{Error, Kind, Result},
    ingest::Ingest,
};

/// Most that is written down in one go.
const MANY: usize = 256;
/// How long a server that stops waits for recordings to be stored; what is not by then is stored at the next start.
const PATIENCE: Duration = Duration::from_secs(20);
/// How often a recording that the disk had no room for is tried again.
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
    /// Of what an inspection may take, and an upload.
    memory_bytes: u64,
    upload_bytes: u64,
    tasks: TaskTracker,
    stopping: CancellationToken,
}

impl Rollouts {
    /// Makes the folder, and begins to keep what an earlier run has left there.
    ///
    /// # Errors
    /// Internal when the folder cannot be made.
    pub fn open(config: &ServeConfig, ingest: Ingest) -> Result<Self> {
        let folder = config.data_dir.join("rollouts");
        std::fs::create_dir_all(&folder).map_err(about::fault("making", &folder))?;
        // What is synced in a folder is lost with the folder's name.
        sync_folder(&config.data_dir)?;
        let rollouts = Self(Arc::new(Inner {
            ingest,
            folder,
            memory_bytes: config.limits.inspect_memory_bytes,
            upload_bytes: config.limits.max_upload_bytes,
            tasks: TaskTracker::new(),
            stopping: CancellationToken::new(),
        }));
        // While serving: neither a robot nor the start waits for it.
        let left = rollouts.left()?;
        let recovering = rollouts.clone();
        rollouts.0.tasks.spawn(async move { recovering.recover(left).await });
        Ok(rollouts)
    }

    /// Records a session that begins now. Nothing is on disk before its first step.
    ///
    /// # Errors
    /// Exhausted when the disk is nearly full.
    pub(crate) fn begin(&self, about: About, task: &Task) -> Result<Recorder> {
        self.0.ingest.blobs().expect_room(0).map_err(|error| {
            Error::exhausted(format!("{}; or open the session without a recording", error.message()))
        })?;
        let (events, told) = mpsc::unbounded_channel();
        let place = self.place(&about.session_id);
        let span = tracing::info_span!("rollout", session.id = %about.session_id);
        let slip = Slip { about, outcome: Outcome::Unknown, steps: None };
        let tape = Tape::new(place.clone(), slip, task.spec.clone(), self.limits(&task.spec));
        let rollouts = self.clone();
        self.0.tasks.spawn(async move { rollouts.record(told, tape, place).await }.instrument(span));
        Ok(Recorder::new(events, task.spec.action_size()))
    }

    /// Waits until every recording is stored, but not for ever: what is not is stored at the next start.
    pub async fn stop(&self) {
        self.0.stopping.cancel();
        self.0.tasks.close();
        if tokio::time::timeout(PATIENCE, self.0.tasks.wait()).await.is_err() {
            tracing::warn!("recordings of sessions are not stored yet; the next start does it");
        }
    }

    /// Writes down what comes, then stores it.
    async fn record(&self, mut told: mpsc::UnboundedReceiver<Event>, tape: Tape, place: Place) {
        let (ending, tell, tape) = match write_down(&mut told, tape, self.0.ingest.blobs()).await {
            Ok((Some((ending, tell)), tape)) => (ending, Some(tell), Ok(tape)),
            // Its recorder was dropped in the middle.
            Ok((None, tape)) => (broken_off(), None, Ok(tape)),
            Err(error) => (broken_off(), None, Err(error)),
        };
        let kept = self.end(tape, ending, &place).await;
        match &kept {
            Ok(Some(episode)) => tracing::info!(episode.id = %episode, "session kept as an episode"),
            Ok(None) => tracing::info!("a session of less than two steps leaves no episode"),
            Err(error) => tracing::error!(error = error as &dyn std::error::Error, "a session's recording is not kept"),
        }
        let later = matches!(&kept, Err(error) if error.kind() == Kind::Exhausted);
        if let Some(tell) = tell {
            // The session may have gone.
            let _ = tell.send(kept);
        }
        if later {
            // Nobody waits for this: if the server stops first, the next start does it.
            let _: Option<()> = self.0.stopping.run_until_cancelled(self.keep_later(&place)).await;
        }
    }

    /// Stores a recording once the disk has room for it.
    async fn keep_later(&self, place: &Place) {
        loop {
            tokio::time::sleep(AGAIN_AFTER).await;
            if self.0.ingest.blobs().expect_room(0).is_err() {
                continue;
            }
            match self.keep(place).await {
                Err(error) if error.kind() == Kind::Exhausted => {}
                Ok(_) => return tracing::info!("a session is kept, now that the disk has room"),
                Err(error) => return tracing::error!(%error, "a session's recording is not kept"),
            }
        }
    }

    async fn end(&self, tape: Result<Tape>, ending: Ending, place: &Place) -> Result<Option<EpisodeId>> {
        if let Ok(tape) = tape
            && !off_runtime(move || tape.end(&ending)).await?
        {
            return Ok(None);
        }
        self.keep(place).await
    }

    fn place(&self, session: &SessionId) -> Place {
        Place::new(&self.0.folder, session.as_str())
    }

    fn folder(&self) -> &Path {
        &self.0.folder
    }

    /// Somewhat below what is refused, because a recording that is refused is lost.
    fn limits(&self, spec: &TaskSpec) -> Limits {
        let step = u64::try_from(frame_bytes_per_step(spec)).unwrap_or(u64::MAX);
        let steps = (self.0.memory_bytes / 4 * 3).checked_div(step).unwrap_or(u64::MAX);
        Limits { steps, bytes: self.0.upload_bytes / 16 * 15 }
    }
}

type Ended = (Ending, tokio::sync::oneshot::Sender<Result<Option<EpisodeId>>>);

/// Until the session ends, or nobody is there to say that it does. The tape goes to other threads and comes back.
async fn write_down(
    told: &mut mpsc::UnboundedReceiver<Event>,
    mut tape: Tape,
    blobs: &Blobs,
) -> Result<(Option<Ended>, Tape)> {
    let mut events = Vec::new();
    loop {
        let sync_at = tape.sync_at();
        let synced = async {
            match sync_at {
                Some(at) => tokio::time::sleep_until(Instant::from_std(at)).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            biased;
            () = synced => {
                let room = blobs.expect_room(0);
                tape = off_runtime(move || {
                    tape.sync();
                    room.unwrap_or_else(|error| tape.stop(&error));
                    Ok(tape)
                })
                .await?;
            }
            taken = told.recv_many(&mut events, MANY) => {
                if taken == 0 {
                    return Ok((None, tape));
                }
                let batch = std::mem::take(&mut events);
                let (back, ended) = off_runtime(move || Ok(write(tape, batch))).await?;
                tape = back;
                if ended.is_some() {
                    return Ok((ended, tape));
                }
            }
        }
    }
}

fn write(mut tape: Tape, events: Vec<Event>) -> (Tape, Option<Ended>) {
    for event in events {
        match event {
            Event::Step(step) => tape.step(&step),
            Event::Note(note) => tape.note(note),
            Event::End(ending, tell) => return (tape, Some((ending, tell))),
        }
    }
    (tape, None)
}

/// Of a session that ended without a word.
fn broken_off() -> Ending {
    let (outcome, how) = (Outcome::Unknown, "broken off".to_owned());
    Ending { outcome, how, answered: 0, dropped: 0, missed: 0, unscored: None, left_out: 0 }
}

/// Runs what blocks away from the runtime's threads.
async fn off_runtime<T: Send + 'static>(work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(|error| Error::internal("recording a session", error))?
}
