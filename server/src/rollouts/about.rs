//! What is known of a recorded session beside its recording: a small file beside it, so that the next start can keep
//! what a crash left.

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
pub(crate) struct About {
    /// Its id.
    pub(crate) session_id: SessionId,
    /// The task of its episode.
    pub(crate) task_id: TaskId,
    /// The deployment that acted.
    pub(crate) deployment: String,
    /// The policy that it pointed at.
    pub(crate) policy_id: PolicyId,
    /// The run that scored it, if any.
    pub(crate) score_run_id: Option<ScoreRunId>,
    /// Control steps a second.
    pub(crate) control_rate_hz: f64,
    /// The cohort of its episode.
    pub(crate) cohort: String,
}

/// The file beside a recording.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct Slip {
    pub(super) about: About,
    /// How the episode ended, as far as anybody has said.
    pub(super) outcome: Outcome,
    /// The recording's steps, once it is whole; `None` while it is written, and after a crash.
    pub(super) steps: Option<u64>,
}

/// Where a session's files are.
#[derive(Debug, Clone)]
pub(super) struct Place {
    folder: PathBuf,
    session: String,
}

impl Place {
    pub(super) fn new(folder: &Path, session: &str) -> Self {
        Self { folder: folder.to_owned(), session: session.to_owned() }
    }

    /// The recording.
    pub(super) fn recording(&self) -> PathBuf {
        self.named("mcap")
    }

    /// What is mended of it.
    pub(super) fn mended(&self) -> PathBuf {
        self.named("mended")
    }

    /// Where it goes if it cannot be used.
    pub(super) fn unusable(&self) -> PathBuf {
        self.folder.join("unusable").join(format!("{}.mcap", self.session))
    }

    /// Keeps the slip; when this returns, it is on disk.
    pub(super) fn write(&self, slip: &Slip) -> Result<()> {
        let json = serde_json::to_vec(slip).map_err(|error| Error::internal("writing a slip", error))?;
        let (draft, place) = (self.named("draft"), self.slip());
        let drafted = File::create(&draft).and_then(|mut file| file.write_all(&json).and_then(|()| file.sync_all()));
        crate::fail_point::pass("rollout.slip_drafted");
        drafted.and_then(|()| fs::rename(&draft, &place)).map_err(fault("writing", &place))?;
        crate::fail_point::pass("rollout.slip_renamed");
        sync_folder(&self.folder)
    }

    /// The slip as it is on disk; `None` when there is none.
    ///
    /// # Errors
    /// Invalid when it says nothing.
    pub(super) fn read(&self) -> Result<Option<Slip>> {
        let place = self.slip();
        match fs::read(&place) {
            Ok(json) => {
                let slip = serde_json::from_slice(&json).map(Some);
                slip.map_err(|error| Error::invalid("recording", format!("{} is spoilt: {error}", place.display())))
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(fault("reading", &place)(error)),
        }
    }

    /// What was mended takes the recording's place.
    pub(super) fn replace(&self) -> Result<()> {
        fs::rename(self.mended(), self.recording()).map_err(fault("replacing", &self.recording()))?;
        sync_folder(&self.folder)
    }

    /// Puts the recording where nothing looks for it any more, and its slip beside it: moved back, both are kept at the
    /// next start, if what was in the way is gone.
    pub(super) fn set_aside(&self) -> Result<()> {
        let (from, to) = (self.recording(), self.unusable());
        // The slip goes first: without its recording it would be removed.
        let slip = || match fs::rename(self.slip(), to.with_extension("json")) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
            Ok(()) | Err(_) => Ok(()),
        };
        let moved = to.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| slip());
        moved.and_then(|()| fs::rename(&from, &to)).map_err(fault("setting aside", &from))?;
        self.remove()
    }

    /// Removes everything of the session.
    pub(super) fn remove(&self) -> Result<()> {
        // The slip goes last: while it is there, the rest is found.
        for path in [self.named("draft"), self.mended(), self.recording(), self.slip()] {
            match fs::remove_file(&path) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    return Err(fault("removing", &path)(error));
                }
                Ok(()) | Err(_) => {}
            }
        }
        Ok(())
    }

    fn slip(&self) -> PathBuf {
        self.named("json")
    }

    fn named(&self, extension: &str) -> PathBuf {
        self.folder.join(format!("{}.{extension}", self.session))
    }
}

/// What a refusal of the disk means.
pub(super) fn fault(doing: &str, path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    let doing = format!("{doing} {}", path.display());
    move |error| Error::internal(doing, error)
}
