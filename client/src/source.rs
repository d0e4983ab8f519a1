//! The bytes of a recording on this machine, with what is declared of them before they are sent: a file, or the join of
//! its parts, which is written to no disk.
//!
//! Reads files; must not know a server.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use gleaner_recording::{RecordingError, RecordingSummary, join, summarize};

use crate::digest::Digest;
use crate::error::{ClientError, Result};
use crate::file::{name_to_send, off_runtime, open_regular};
use crate::parts::{in_order, number, parts_in};

/// A recording to send.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    /// What the caller named, for messages.
    pub(crate) path: PathBuf,
    file_name: String,
    pub(crate) files: Files,
}

/// The files of a recording.
#[derive(Clone, Debug)]
pub(crate) enum Files {
    One(PathBuf),
    /// Several, in their order.
    Parts(Arc<[PathBuf]>),
}

/// What is declared of a recording before it is sent.
#[derive(Clone, Debug)]
pub(crate) struct Declared {
    pub(crate) file_name: String,
    pub(crate) digest: Digest,
    /// `None` where the file has no sound summary; the server finds its damage.
    pub(crate) summary: Option<RecordingSummary>,
}

impl Source {
    /// A file, or a folder of the parts of one recording. With `parts`, those files, and `path` is for messages.
    ///
    /// # Errors
    /// [`ClientError::Io`]; [`ClientError::Invalid`] names a part that is missing or of another recording.
    pub(crate) fn of(path: &Path, parts: &[PathBuf]) -> Result<Self> {
        if !parts.is_empty() {
            let parts = in_order(parts.to_vec(), path)?;
            let name = parts.first().and_then(|part| number(part)).map_or_else(String::new, |(name, _)| name);
            return Ok(Self::joined(path, &format!("{name}.mcap"), parts));
        }
        if !path.is_dir() {
            let files = Files::One(path.to_owned());
            return Ok(Self { path: path.to_owned(), file_name: name_to_send(path), files });
        }
        // The folder may be named `.`.
        let folder = path.canonicalize().map_err(ClientError::io(path))?;
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        Ok(Self::joined(path, &format!("{name}.mcap"), parts_in(path)?))
    }

    /// A recording of one part is that file itself.
    fn joined(path: &Path, name: &str, parts: Vec<PathBuf>) -> Self {
        let path = path.to_owned();
        match <[PathBuf; 1]>::try_from(parts) {
            Ok([file]) => Self { path, file_name: name_to_send(&file), files: Files::One(file) },
            Err(parts) => Self { path, file_name: name_to_send(Path::new(name)), files: Files::Parts(parts.into()) },
        }
    }

    /// Reads the recording through once.
    pub(crate) async fn declare(&self) -> Result<Declared> {
        let source = self.clone();
        off_runtime(self.path.clone(), move || source.read()).await
    }

    fn read(self) -> Result<Declared> {
        let (digest, summary) = match &self.files {
            Files::One(path) => (Digest::of(path)?, summarize(path).ok().flatten()),
            Files::Parts(parts) => digest_joined(parts)?,
        };
        Ok(Declared { file_name: self.file_name, digest, summary })
    }
}

/// A recording as one file: the file itself, or for a folder of the parts of one recording their join, which is written
/// into `folder`.
///
/// # Errors
/// [`ClientError::Io`]; [`ClientError::Invalid`] names a part that is missing or of another recording.
pub async fn whole_recording(path: &Path, folder: &Path) -> Result<PathBuf> {
    let source = Source::of(path, &[])?;
    let joined = folder.join("joined.mcap");
    off_runtime(path.to_owned(), move || match source.files {
        Files::One(file) => {
            open_regular(&file)?;
            Ok(file)
        }
        Files::Parts(parts) => {
            for part in parts.iter() {
                open_regular(part)?;
            }
            let out = std::fs::File::create(&joined).map_err(ClientError::io(&joined))?;
            join(&parts, std::io::BufWriter::new(out)).map_err(not_joined)?;
            Ok(joined)
        }
    })
    .await
}

fn digest_joined(parts: &[PathBuf]) -> Result<(Digest, Option<RecordingSummary>)> {
    for part in parts {
        open_regular(part)?;
    }
    let mut hasher = blake3::Hasher::new();
    let summary = join(parts, &mut hasher).map_err(not_joined)?;
    Ok((Digest { size_bytes: hasher.count(), blake3: hasher.finalize().to_hex().to_string() }, Some(summary)))
}

fn not_joined(error: RecordingError) -> ClientError {
    if let RecordingError::Io { path, source } = error {
        return ClientError::Io { path, source };
    }
    ClientError::Invalid(error.to_string())
}
