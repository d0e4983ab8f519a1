//! Exports: a dataset's files into a new folder, and a whole episode with its scores into one file. A folder or file
//! appears under its name only when it is complete.

use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use futures::StreamExt as _;
use gleaner_core::proto::task::spec_from_proto;
use gleaner_proto::v1::{
    DownloadExportFileRequest, Episode, EpisodeScores, ExportFile, GetEpisodeScoresRequest, GetTaskRequest, Outcome,
};
use gleaner_recording::{Kept, RecordingError, WholeEpisode};
use tempfile::TempDir;

use crate::connection::Client;
use crate::download::{Expected, Piece, download, relative};
use crate::error::{ClientError, Result};

impl Client {
    /// Lists the files of a finished export.
    ///
    /// # Errors
    /// The codes of `ListExportFiles`.
    pub async fn export_files(&self, export_id: &str) -> Result<Vec<ExportFile>> {
        Ok(self.every_export_file(export_id).await?.files)
    }

    /// Downloads every file of an export into a new folder, checks their digests, and calls `progress` with the bytes so
    /// far. After an error there is no folder.
    ///
    /// # Errors
    /// [`ClientError::Invalid`] when the folder has files; as for [`Client::download_episode`].
    pub async fn download_export(
        &self,
        export_id: &str,
        files: &[ExportFile],
        folder: &Path,
        progress: impl Fn(u64),
    ) -> Result<()> {
        expect_new_folder(folder)?;
        let part = part_of(folder)?;
        let mut before = 0;
        for file in files {
            let path = part.path().join(relative(&file.name)?);
            let open = async |accept_url| {
                let (export_id, name) = (export_id.to_owned(), file.name.clone());
                let request = DownloadExportFileRequest { export_id, name, accept_url };
                let pieces = self.datasets().download_export_file(request).await?.into_inner();
                Ok(pieces.map(|piece| piece.map(|piece| Piece { data: piece.data, url: piece.url })))
            };
            let expected = Expected { blake3: &file.blake3, size_bytes: file.size_bytes };
            download(self.direct(), open, &path, &expected, |bytes| progress(before + bytes)).await?;
            before += file.size_bytes;
        }
        complete(part, folder)
    }

    /// Writes a whole episode of a score run as MCAP: its recording with the scores of every step beside its messages, in
    /// their dialect. Steps with q above `beta` are marked as kept.
    ///
    /// # Errors
    /// [`ClientError::Invalid`] when the file exists; the codes of `GetEpisodeScores`; as for
    /// [`Client::download_episode`]; [`ClientError::Recording`] when the recording cannot be copied.
    pub async fn export_episode(&self, episode_id: &str, run_id: &str, beta: f64, out: &Path) -> Result<Episode> {
        expect_new_file(out)?;
        let request = GetEpisodeScoresRequest { score_run_id: run_id.to_owned(), episode_id: episode_id.to_owned() };
        let scores = self.scores().get_episode_scores(request).await?.into_inner().scores;
        let scores = scores.ok_or(ClientError::Contract { missing: "scores" })?;
        let beside = parent(out);
        std::fs::create_dir_all(beside).map_err(ClientError::io(beside))?;
        let folder =
            tempfile::Builder::new().prefix(".gleaner-").tempdir_in(beside).map_err(ClientError::io(beside))?;
        let recording = folder.path().join("recording.mcap");
        let episode = self.download_episode(episode_id, &recording, |_| {}).await?;
        let task = self.tasks().get_task(GetTaskRequest { task: episode.task_id.clone() }).await?.into_inner().task;
        let spec = task.and_then(|task| task.spec).ok_or(ClientError::Contract { missing: "a task" })?;
        let spec = spec_from_proto(spec).map_err(|error| ClientError::Invalid(error.to_string()))?;
        let kept = kept(&episode, run_id, beta, &scores);
        // In the folder that is deleted on drop, so that a copy that is interrupted leaves no file.
        let whole = folder.path().join("whole.mcap");
        let copy = whole.clone();
        let copied = tokio::task::spawn_blocking(move || gleaner_recording::extract(&recording, &spec, &kept, &copy));
        let ended = |error: tokio::task::JoinError| RecordingError::BrokenImage { problem: error.to_string() };
        copied.await.map_err(ended)??;
        std::fs::rename(&whole, out).map_err(ClientError::io(out))?;
        Ok(episode)
    }
}

/// Checks that a folder does not exist or is empty, before work begins whose result goes there.
///
/// # Errors
/// [`ClientError::Invalid`] when it has files; [`ClientError::Io`] when it is a file, or cannot be read or written.
pub fn expect_new_folder(folder: &Path) -> Result<()> {
    match std::fs::read_dir(folder).map(|mut entries| entries.next()) {
        Ok(None) => {}
        Ok(Some(_)) => {
            let folder = folder.display();
            return Err(ClientError::Invalid(format!(
                "{folder} has files in it; give a new folder, or remove it first"
            )));
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
        Err(error) => return Err(ClientError::io(folder)(error)),
    }
    let there = folder.ancestors().find(|folder| folder.exists()).unwrap_or(Path::new("."));
    tempfile::tempdir_in(there).map_err(ClientError::io(there))?;
    Ok(())
}

/// A hidden folder for the files of `folder` until all are there, deleted on drop: beside it, or, where it exists, in it,
/// because a mount cannot be replaced.
fn part_of(folder: &Path) -> Result<TempDir> {
    let place = if folder.exists() { folder } else { parent(folder) };
    std::fs::create_dir_all(place).map_err(ClientError::io(place))?;
    let readable = std::fs::Permissions::from_mode(0o777);
    let part = tempfile::Builder::new().prefix(".gleaner-").permissions(readable).tempdir_in(place);
    part.map_err(ClientError::io(place))
}

/// Gives the files of a part their folder.
fn complete(part: TempDir, folder: &Path) -> Result<()> {
    if !folder.exists() {
        std::fs::rename(part.path(), folder).map_err(ClientError::io(folder))?;
        // The folder has moved: it needs no removal.
        let _ = part.keep();
        return Ok(());
    }
    for entry in std::fs::read_dir(part.path()).map_err(ClientError::io(folder))? {
        let entry = entry.map_err(ClientError::io(folder))?;
        std::fs::rename(entry.path(), folder.join(entry.file_name())).map_err(ClientError::io(folder))?;
    }
    Ok(())
}

/// Checks that a file does not exist, before work begins whose result goes there.
///
/// # Errors
/// [`ClientError::Invalid`] when there is a file, a folder or a device of this name.
pub fn expect_new_file(file: &Path) -> Result<()> {
    if file.exists() {
        return Err(ClientError::Invalid(format!("{} exists; give another name or remove it", file.display())));
    }
    Ok(())
}

fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        Some(_) | None => Path::new("."),
    }
}

/// What the scores state of an episode.
fn kept(episode: &Episode, run_id: &str, beta: f64, scores: &EpisodeScores) -> Kept {
    let outcome = match episode.outcome() {
        Outcome::Success => "success",
        Outcome::Failure => "failure",
        Outcome::Unknown | Outcome::Unspecified => "unknown",
    };
    let whole = WholeEpisode {
        id: &episode.id,
        file_name: &episode.file_name,
        outcome,
        cohort: &episode.cohort,
        run: run_id,
        beta,
        q: &scores.q,
        w: &scores.w,
    };
    // Scorers without matches, such as imports, have empty lists.
    whole.kept(|at| {
        let index = usize::try_from(*scores.match_episode.get(at)?).ok()?;
        Some((scores.expert_ids.get(index)?.clone(), *scores.match_step.get(at)?))
    })
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::MetadataExt as _;

    use super::*;

    #[test]
    fn a_folder_with_files_is_refused_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        expect_new_folder(folder.path()).unwrap();
        expect_new_folder(&folder.path().join("new")).unwrap();
        let file = folder.path().join("a");
        std::fs::write(&file, b"mine").unwrap();
        let message = expect_new_folder(folder.path()).unwrap_err().to_string();
        assert!(message.contains("has files in it"), "{message}");
        assert!(matches!(expect_new_folder(&file), Err(ClientError::Io { .. })));
        assert_eq!(std::fs::read(&file).unwrap(), b"mine");
        expect_new_file(&folder.path().join("b")).unwrap();
        for taken in [&file, folder.path(), Path::new("/dev/null")] {
            assert!(expect_new_file(taken).unwrap_err().to_string().contains("exists; give another name"));
        }
    }

    #[test]
    fn files_appear_at_once_in_a_new_folder_and_in_an_empty_one_that_stays() {
        let place = tempfile::tempdir().unwrap();
        let (new, empty) = (place.path().join("a/new"), place.path().join("mount"));
        std::fs::create_dir(&empty).unwrap();
        // A mount cannot be replaced by a rename: the folder is the same one afterwards.
        let mounted = std::fs::metadata(&empty).unwrap().ino();
        for folder in [&new, &empty] {
            let part = part_of(folder).unwrap();
            std::fs::create_dir(part.path().join("data")).unwrap();
            std::fs::write(part.path().join("data/0.mcap"), b"steps").unwrap();
            complete(part, folder).unwrap();
            assert_eq!(std::fs::read(folder.join("data/0.mcap")).unwrap(), b"steps");
            assert_eq!(std::fs::read_dir(folder).unwrap().count(), 1, "nothing else is left there");
        }
        assert_eq!(std::fs::metadata(&empty).unwrap().ino(), mounted);
        drop(part_of(&place.path().join("other")).unwrap());
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 2, "a part that is not completed is removed");
    }

    #[test]
    fn every_step_has_its_match() {
        let scores = EpisodeScores {
            q: vec![0.25, 0.95],
            w: vec![-2.0, -1.0],
            match_episode: vec![1, 0],
            match_step: vec![4, 9],
            expert_ids: vec!["ep_a".into(), "ep_b".into()],
            ..EpisodeScores::default()
        };
        let matches = |scores: &EpisodeScores| {
            let kept = kept(&Episode::default(), "run_1", 0.9, scores);
            kept.scores.into_iter().map(|score| score.matched).collect::<Vec<_>>()
        };
        assert_eq!(matches(&scores), [Some(("ep_b".into(), 4)), Some(("ep_a".into(), 9))]);
        let none = EpisodeScores { match_episode: Vec::new(), match_step: Vec::new(), ..scores };
        assert_eq!(matches(&none), [None, None]);
    }
}
