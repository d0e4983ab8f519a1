//! The files of a recorded session: the recording and its sidecar, from which the next start stores a recording left by
//! a crash.

use std::{
    fs::{self, File},
    io::Write as _,
    path::{Path, PathBuf},
};

use crate::{
    blobs::sync_folder,
    domain::{
        episode::Outcome,
        id::{PolicyId, ScoreRunId, SessionId, TaskId},
    },
    error::{Error, Result},
};

/// A session that is recorded.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(crate) struct SessionInfo {
    /// Its id.
    pub(crate) session_id: SessionId,
    /// The task of its episode.
    pub(crate) task_id: TaskId,
    /// The deployment of the session.
    pub(crate) deployment: String,
    /// The policy of the deployment.
    pub(crate) policy_id: PolicyId,
    /// The run of its live scores, if any.
    pub(crate) score_run_id: Option<ScoreRunId>,
    /// Control steps per second.
    pub(crate) control_rate_hz: f64,
    /// The cohort of its episode.
    pub(crate) cohort: String,
}

/// The file beside a recording.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct RolloutSidecar {
    /// Named `about` in sidecars of earlier versions.
    #[serde(alias = "about")]
    pub(super) session: SessionInfo,
    /// The outcome of the episode, as far as it is known.
    pub(super) outcome: Outcome,
    /// The recording's steps once it is whole; `None` while it is written, and after a crash.
    pub(super) steps: Option<u64>,
}

/// The paths of a session's files.
#[derive(Debug, Clone)]
pub(super) struct RolloutFiles {
    folder: PathBuf,
    session: String,
}

impl RolloutFiles {
    pub(super) fn new(folder: &Path, session: &str) -> Self {
        Self { folder: folder.to_owned(), session: session.to_owned() }
    }

    /// The recording.
    pub(super) fn recording(&self) -> PathBuf {
        self.named("mcap")
    }

    /// The salvaged copy of a torn recording.
    pub(super) fn salvaged(&self) -> PathBuf {
        self.named("salvaged")
    }

    /// The place of an unusable recording.
    pub(super) fn unusable(&self) -> PathBuf {
        self.folder.join("unusable").join(format!("{}.mcap", self.session))
    }

    /// Writes the sidecar durably.
    pub(super) fn write(&self, sidecar: &RolloutSidecar) -> Result<()> {
        let json = serde_json::to_vec(sidecar).map_err(|error| Error::internal("writing a sidecar", error))?;
        let (draft, path) = (self.named("draft"), self.sidecar());
        let drafted = File::create(&draft).and_then(|mut file| file.write_all(&json).and_then(|()| file.sync_all()));
        crate::fail_point::pass("rollout.sidecar_drafted");
        drafted.and_then(|()| fs::rename(&draft, &path)).map_err(fault("writing", &path))?;
        crate::fail_point::pass("rollout.sidecar_renamed");
        sync_folder(&self.folder)
    }

    /// Reads the sidecar; `None` when the file is missing.
    ///
    /// # Errors
    /// Invalid when it cannot be parsed.
    pub(super) fn read(&self) -> Result<Option<RolloutSidecar>> {
        let path = self.sidecar();
        match fs::read(&path) {
            Ok(json) => {
                let sidecar = serde_json::from_slice(&json).map(Some);
                sidecar.map_err(|error| {
                    Error::invalid("recording", format!("{} cannot be parsed: {error}", path.display()))
                })
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(fault("reading", &path)(error)),
        }
    }

    /// Replaces the recording with its salvaged copy.
    pub(super) fn replace(&self) -> Result<()> {
        fs::rename(self.salvaged(), self.recording()).map_err(fault("replacing", &self.recording()))?;
        sync_folder(&self.folder)
    }

    /// Moves the recording and its sidecar to the folder of unusable recordings. Moved back, both are stored at the
    /// next start if the cause is gone.
    pub(super) fn set_aside(&self) -> Result<()> {
        let (from, to) = (self.recording(), self.unusable());
        // The sidecar first: without its recording it would be removed.
        let sidecar = || match fs::rename(self.sidecar(), to.with_extension("json")) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
            Ok(()) | Err(_) => Ok(()),
        };
        let moved = to.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| sidecar());
        moved.and_then(|()| fs::rename(&from, &to)).map_err(fault("setting aside", &from))?;
        // A power cut must not lose the new name after the old one.
        to.parent().map_or(Ok(()), sync_folder)?;
        sync_folder(&self.folder)?;
        self.remove()
    }

    /// Removes all files of the session.
    pub(super) fn remove(&self) -> Result<()> {
        // The sidecar last: the next start finds the other files by it.
        for path in [self.named("draft"), self.salvaged(), self.recording(), self.sidecar()] {
            match fs::remove_file(&path) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    return Err(fault("removing", &path)(error));
                }
                Ok(()) | Err(_) => {}
            }
        }
        Ok(())
    }

    fn sidecar(&self) -> PathBuf {
        self.named("json")
    }

    fn named(&self, extension: &str) -> PathBuf {
        self.folder.join(format!("{}.{extension}", self.session))
    }
}

/// Maps an error of the file system.
pub(super) fn fault(doing: &str, path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    let doing = format!("{doing} {}", path.display());
    move |error| Error::internal(doing, error)
}
