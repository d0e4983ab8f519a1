//! Recordings made by the server itself: uploads without a client.

use std::path::Path;

use super::{Ingest, Started, off_runtime};
use crate::{
    blobs::{self, sync_folder},
    domain::{
        client::Client,
        episode::{Episode, NewUpload, Outcome},
        id::{TaskId, UploadId},
    },
    error::{Error, Kind, Result},
};

/// The fewest steps of an episode.
const FEWEST_STEPS: u64 = 2;
/// Bytes by which the salvaged copy of a recording without damage may be shorter: it has fewer chunks.
const SHORTER: u64 = 4096;

/// A recording on this machine that is to become an episode.
#[derive(Debug, Clone)]
pub(crate) struct NewRecording {
    pub(crate) task_id: TaskId,
    pub(crate) file_name: String,
    pub(crate) outcome: Outcome,
    pub(crate) cohort: String,
    pub(crate) author: String,
}

impl Ingest {
    /// Stores a file of the data directory as an episode. The file stays and must not be written any more. When the
    /// task holds the content already, that episode is the answer, whatever its label: so an interrupted call can be
    /// repeated.
    ///
    /// # Errors
    /// Invalid when the task cannot use it or it is too large; Exhausted when the disk is full; Unavailable when its
    /// inspection was stopped; Internal.
    pub(crate) async fn keep(&self, new: NewRecording, recording: &Path) -> Result<Episode> {
        let path = recording.to_owned();
        let (size_bytes, blake3) = off_runtime("reading a recording", move || {
            let fault = |error| Error::internal(format!("reading {}", path.display()), error);
            Ok((std::fs::metadata(&path).map_err(fault)?.len(), blobs::digest(&path)?))
        })
        .await?;
        if size_bytes > self.max_upload_bytes {
            // Unlike a full disk, this does not change.
            let limit = self.max_upload_bytes;
            let fix = format!("{size_bytes} bytes are above this server's limit of {limit} (--max-upload-bytes)");
            return Err(Error::invalid("recording", fix));
        }
        let NewRecording { task_id, file_name, outcome, cohort, author } = new;
        let existing = || async { self.store.episode_of(&task_id, &blake3).await };
        let (task, digest) = (task_id.clone(), blake3.clone());
        let client = Client::Server;
        let new = NewUpload {
            task_id: task,
            file_name,
            size_bytes,
            blake3: digest,
            outcome,
            cohort,
            author,
            client,
            summary: None,
        };
        let stored = match self.start(new).await {
            Ok(Started::Existing(episode)) => Ok(episode),
            Ok(Started::Open(upload)) => self.finish_file(&upload.id, recording, size_bytes).await,
            Err(error) => Err(error),
        };
        match stored {
            // It was stored before, and has another label since.
            Err(error) if error.kind() == Kind::Exists => existing().await?.ok_or(error),
            stored => stored,
        }
    }

    /// The file becomes the upload's part, as another name of the same bytes.
    async fn finish_file(&self, id: &UploadId, recording: &Path, size: u64) -> Result<Episode> {
        let (part, recording) = (self.part_path(id), recording.to_owned());
        off_runtime("linking a recording", move || link(&recording, &part)).await?;
        crate::fail_point::pass("rollout.linked");
        self.store.commit_upload(id, size).await?;
        crate::fail_point::pass("rollout.committed");
        self.finish_here(id).await.map(|inspected| inspected.episode)
    }

    /// Salvages a torn recording to `out`, in a child under the limits of an inspection, and returns the most steps it
    /// may have. Fewer than an episode needs are the whole content of the file: it can be removed.
    ///
    /// # Errors
    /// Invalid when no part of it can be read, or less than an episode needs of a file with more content; Internal.
    pub(crate) async fn salvage(&self, torn: &Path, out: &Path) -> Result<u64> {
        let steps = self.inspector.salvage(torn, out).await.map_err(|error| self.blobs.blame(error))?;
        if steps < FEWEST_STEPS {
            let (torn, out) = (torn.to_owned(), out.to_owned());
            off_runtime("comparing a salvaged recording", move || expect_no_more(&torn, &out, steps)).await?;
        }
        Ok(steps)
    }
}

/// Rejects a file that is longer than its salvaged copy, which has all content that can be read: the rest may be steps
/// that a person can still rescue.
fn expect_no_more(torn: &Path, out: &Path, steps: u64) -> Result<()> {
    let size = |path: &Path| {
        let file = std::fs::metadata(path);
        file.map(|file| file.len()).map_err(|error| Error::internal(format!("reading {}", path.display()), error))
    };
    let (whole, readable) = (size(torn)?, size(out)?);
    if whole <= readable + SHORTER {
        return Ok(());
    }
    let problem = format!("{steps} steps can be read of its {whole} bytes, of which about {readable} are not damaged");
    Err(Error::invalid("recording", problem))
}

fn link(recording: &Path, part: &Path) -> Result<()> {
    let fault = |error| Error::internal(format!("linking {}", recording.display()), error);
    std::fs::File::open(recording).and_then(|file| file.sync_all()).map_err(fault)?;
    // In one rename, so that there is always a part.
    let draft = part.with_extension("draft");
    clear(&draft).map_err(fault)?;
    match std::fs::hard_link(recording, &draft) {
        // An operator may have moved one of the two folders to another disk.
        Err(error) if error.kind() == std::io::ErrorKind::CrossesDevices => {
            std::fs::copy(recording, &draft).and_then(|_| std::fs::File::open(&draft)?.sync_all()).map_err(fault)?;
        }
        linked => linked.map_err(fault)?,
    }
    std::fs::rename(&draft, part).map_err(fault)?;
    // When both were names of one file already, the rename did not remove `from`.
    clear(&draft).map_err(fault)?;
    part.parent().map_or(Ok(()), sync_folder)
}

fn clear(path: &Path) -> std::io::Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        Ok(()) | Err(_) => Ok(()),
    }
}

#[cfg(test)]
mod tests {

    use std::{fs, path::PathBuf};

    use super::*;
    use crate::ingest::testing::{Fixture, USABLE, playing, real, recording as recording_of};

    /// A recording outside of the uploads, as a session leaves it.
    fn recorded(f: &Fixture) -> (NewRecording, PathBuf) {
        let path = f.dir.path().join("rollout.mcap");
        fs::write(&path, b"recording").unwrap();
        let new = f.new_upload(b"recording");
        let (task_id, file_name, outcome) = (new.task_id, new.file_name, new.outcome);
        (NewRecording { task_id, file_name, outcome, cohort: new.cohort, author: new.author }, path)
    }

    /// Memory and disk are two file systems on most machines.
    #[test]
    fn a_recording_of_another_disk_is_copied() {
        let here = tempfile::tempdir().unwrap();
        let there = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
        let (recording, part) = (there.path().join("rollout.mcap"), here.path().join("part"));
        fs::write(&recording, b"recording").unwrap();
        link(&recording, &part).unwrap();
        assert_eq!(
            (fs::read(&part).unwrap(), fs::read(&recording).unwrap()),
            (b"recording".into(), b"recording".into())
        );
        assert_eq!(fs::read_dir(here.path()).unwrap().count(), 1, "no draft is left");
    }

    #[tokio::test]
    async fn a_crash_between_the_link_and_its_row_loses_no_recording() {
        let mut f = playing(USABLE).await;
        let (new, recording) = recorded(&f);
        let upload = f.start(b"recording").await;
        link(&recording, &f.ingest.part_path(&upload.id)).unwrap();
        f.reopen().await;
        assert_eq!(fs::read(&recording).unwrap(), b"recording");
        assert_eq!(f.ingest.keep(new, &recording).await.unwrap().steps, 20);
        assert!(f.files(&["uploads", "tmp"]).is_empty(), "{:?}", f.files(&["uploads", "tmp"]));
    }

    #[tokio::test]
    async fn a_crash_between_the_move_and_its_row_leaves_no_part() {
        let mut f = playing(USABLE).await;
        let (new, recording) = recorded(&f);
        let upload = f.start(b"recording").await;
        let part = f.ingest.part_path(&upload.id);
        link(&recording, &part).unwrap();
        f.store.commit_upload(&upload.id, upload.size_bytes).await.unwrap();
        f.ingest.blobs().place(&upload.blake3, &part).unwrap();
        f.reopen().await;
        // Recording, part and blob are now names of one file.
        assert_eq!(f.ingest.keep(new, &recording).await.unwrap().steps, 20);
        assert!(f.files(&["uploads", "tmp"]).is_empty(), "{:?}", f.files(&["uploads", "tmp"]));
        assert_eq!(fs::read(f.ingest.blobs().path(&upload.blake3)).unwrap(), b"recording");
    }

    #[tokio::test]
    async fn a_client_that_resumes_the_upload_does_not_write_into_the_recording() {
        let f = playing(USABLE).await;
        let (_, recording) = recorded(&f);
        let upload = f.start(b"recording").await;
        f.write(&upload.id, 0, b"re").await.unwrap();
        link(&recording, &f.ingest.part_path(&upload.id)).unwrap();
        assert_eq!(f.write(&upload.id, 2, b"CO").await.unwrap(), 4);
        assert_eq!(fs::read(&recording).unwrap(), b"recording");
        assert_eq!(fs::read(f.ingest.part_path(&upload.id)).unwrap(), b"reCO");
    }

    #[tokio::test]
    async fn a_stopped_inspection_does_not_reject_the_recording() {
        // The system also sends KILL when the whole machine is out of memory.
        for signal in ["TERM", "KILL"] {
            let f = playing(&format!("kill -{signal} $$")).await;
            let (new, recording) = recorded(&f);
            let error = f.ingest.keep(new, &recording).await.unwrap_err();
            assert_eq!(error.kind(), Kind::Unavailable, "{error}");
            assert_eq!(f.store.uploads().await.unwrap().len(), 1, "it can be finished again");
        }
    }

    /// Ctrl-C is sent to a whole process group.
    #[tokio::test]
    async fn an_inspection_has_its_own_process_group() {
        let f = playing(&format!("set -- $(cat /proc/$$/stat); [ $5 = $$ ] && {USABLE}")).await;
        let (new, recording) = recorded(&f);
        assert_eq!(f.ingest.keep(new, &recording).await.unwrap().steps, 20);
    }

    #[tokio::test]
    async fn a_recording_above_the_limit_is_permanently_rejected() {
        let f = real("none", &["--max-upload-bytes", "8"]).await;
        let (new, recording) = recorded(&f);
        let error = f.ingest.keep(new, &recording).await.unwrap_err();
        assert_eq!(error.kind(), Kind::Invalid, "{error}");
        assert!(error.message().contains("--max-upload-bytes"), "{error}");
    }

    #[tokio::test]
    async fn a_damaged_recording_is_not_salvaged_as_one_without_steps() {
        let f = real("none", &[]).await;
        let [torn, out] = ["torn.mcap", "torn.salvaged"].map(|name| f.dir.path().join(name));
        let (short, long) = (recording_of(&f.task, 1), recording_of(&f.task, 20));
        fs::write(&torn, &short).unwrap();
        assert_eq!(f.ingest.salvage(&torn, &out).await.unwrap(), 1);
        // All but the header of the file.
        let mut damaged = [&long[..], &[7; 9000]].concat();
        damaged[64..].fill(0xff);
        fs::write(&torn, damaged).unwrap();
        let error = f.ingest.salvage(&torn, &out).await.unwrap_err();
        assert_eq!(error.kind(), Kind::Invalid, "{error}");
        assert!(error.message().contains("0 steps can be read"), "{error}");
    }
}
