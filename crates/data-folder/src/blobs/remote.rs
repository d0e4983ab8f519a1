//! A bucket behind the blobs. Each blob is in the bucket under its path in the data folder, and its file in the folder is
//! a copy, which is fetched when it is missing and removed when the copies exceed their limit. Sidecars and the stamp are
//! in the data folder alone.
//!
//! A file of the data folder names the bucket, so that every process that opens the folder finds it; credentials come
//! from the environment, or the server that has them is called (`by_server`). Without that file, the folder holds the blobs
//! itself.

use std::{
    fs,
    io::Write as _,
    path::Path,
    sync::{Arc, Mutex},
    time::{Instant, SystemTime},
};

use gleaner_bucket::{Bucket, BucketConfig};
use serde::{Deserialize, Serialize};

use super::{
    Blobs, across,
    calls::{BlobServer, ByServer},
    fault, sync_folder,
};
use gleaner_core::error::{Error, Result};

/// Name of the file that names the bucket.
const FILE: &str = "blob-store.json";
/// Name of the file with the owner's name: it exists before the bucket has it, so that an interrupted move can be repeated.
const OWNER: &str = "blob-store-owner";

/// The way of this process to the bucket of a data folder.
#[derive(Debug)]
pub(super) enum Remote {
    /// With credentials: of the server and of the operator's commands.
    Bucket(OwnBucket),
    /// By the server, which has them: of workers.
    Server(ByServer),
}

/// The bucket of a data folder, and the limit on the copies in the folder.
#[derive(Debug)]
pub(super) struct OwnBucket {
    pub(super) bucket: Bucket,
    /// 0: no limit.
    pub(super) most_bytes: u64,
    /// The bytes of the copies, and the time at which they were listed.
    pub(super) copies: Mutex<Option<(u64, Instant)>>,
}

impl Remote {
    pub(super) fn new(bucket: Bucket, most_bytes: u64) -> Self {
        Self::Bucket(OwnBucket { bucket, most_bytes, copies: Mutex::default() })
    }

    pub(super) fn by(server: Arc<dyn BlobServer>) -> Self {
        Self::Server(ByServer::new(server))
    }

    /// The bucket itself.
    ///
    /// # Errors
    /// Internal in a process without credentials.
    pub(super) fn own(&self) -> Result<&OwnBucket> {
        match self {
            Self::Bucket(own) => Ok(own),
            Self::Server(_) => {
                Err(Error::internal("using the bucket", "this process has no credentials of it; the server has"))
            }
        }
    }
}

/// What the data folder remembers of its bucket.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Remembered {
    #[serde(flatten)]
    bucket: BucketConfig,
    cache_bytes: u64,
    /// Written to the bucket too, so that no two data folders use one prefix.
    owner: String,
}

/// Makes a bucket hold the blobs of a data folder from now on. Blobs that the folder holds are put into the bucket
/// first. `None` keeps the bucket that the folder has, if any.
///
/// # Errors
/// Precondition when the folder has another bucket or is a backup, the bucket belongs to another folder, or its settings
/// cannot be used;
/// Unavailable when the store fails; Internal when the disk fails.
pub fn settle(data_dir: &Path, wanted: Option<(BucketConfig, u64)>) -> Result<()> {
    let before = read(data_dir)?;
    let Some((bucket, cache_bytes)) = wanted else {
        return before.map_or(Ok(()), |before| Bucket::open(&before.bucket)?.expect_owner(&before.owner));
    };
    // Before a message repeats the URL, which may have a password where none belongs.
    bucket.place()?;
    if before.is_none() && crate::is_unused_backup(data_dir) {
        let problem = crate::backup_is_no_lab(data_dir);
        return Err(Error::precondition(format!("--blob-store {}: {problem}", bucket.url)));
    }
    if let Some(before) = before.as_ref().filter(|before| before.bucket.url != bucket.url) {
        return Err(Error::precondition(format!(
            "--blob-store {}: the blobs of {} are in {}. To move them, back the folder up, restore it to a new folder and \
             start there with the new bucket",
            bucket.url,
            data_dir.display(),
            before.bucket.url
        )));
    }
    let opened = Bucket::open(&bucket)?;
    let owner = match &before {
        Some(before) => before.owner.clone(),
        None => kept_owner(data_dir)?,
    };
    if before.is_some() {
        opened.expect_owner(&owner)?;
    } else {
        opened.claim(&owner)?;
        fill(&opened, &Blobs::of(data_dir, None))?;
        tracing::info!(store = opened.shown(), "the bucket holds the blobs of this data folder from now on");
    }
    let now = Remembered { bucket, cache_bytes, owner };
    if before.as_ref() == Some(&now) { Ok(()) } else { write(data_dir, &now) }
}

/// Puts the blobs of a folder into its bucket. An object of the right size stays, and so does any object whose file is
/// damaged: where the folder has lost the name of its bucket, its files are copies, and the object may be the only whole
/// one.
pub(super) fn fill(bucket: &Bucket, blobs: &Blobs) -> Result<()> {
    for found in blobs.list()?.into_iter().chain(blobs.list_trash()?) {
        let Some(id) = &found.id else { continue };
        let name = name(&blobs.folder, &found.path);
        match bucket.size(&name)? {
            Some(size) if size == found.size_bytes => {}
            Some(size) if found.digest()? != *id => {
                tracing::error!(blob.id = %id, object = size, "a file is damaged: the bucket keeps its object of another size");
            }
            Some(_) | None => bucket.put(&name, &found.path)?,
        }
    }
    Ok(())
}

/// Whether a bucket holds the blobs of a data folder.
pub fn has_bucket(data_dir: &Path) -> bool {
    data_dir.join(FILE).is_file()
}

/// The bucket that a data folder names, if any.
pub(super) fn of(data_dir: &Path) -> Result<Option<Arc<Remote>>> {
    let Some(found) = read(data_dir)? else { return Ok(None) };
    Ok(Some(Arc::new(Remote::new(Bucket::open(&found.bucket)?, found.cache_bytes))))
}

/// The name in the bucket of a path in the data folder.
pub(super) fn name(data_dir: &Path, path: &Path) -> String {
    path.strip_prefix(data_dir).unwrap_or(path).to_string_lossy().into_owned()
}

fn read(data_dir: &Path) -> Result<Option<Remembered>> {
    let path = data_dir.join(FILE);
    match fs::read(&path) {
        Ok(json) => serde_json::from_slice(&json).map(Some).map_err(|error| {
            Error::precondition(format!("{} cannot be read: {error}; restore it from a copy", path.display()))
        }),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(fault("reading", &path)(error)),
    }
}

fn write(data_dir: &Path, remembered: &Remembered) -> Result<()> {
    let json = serde_json::to_vec_pretty(remembered).map_err(|error| Error::internal("writing a file", error))?;
    write_file(data_dir, FILE, &json)
}

fn write_file(data_dir: &Path, name: &str, content: &[u8]) -> Result<()> {
    let path = data_dir.join(name);
    let mut draft = across::draft(data_dir).map_err(fault("writing", &path))?;
    draft.write_all(content).and_then(|()| draft.as_file().sync_all()).map_err(fault("writing", &path))?;
    draft.persist(&path).map_err(|error| fault("writing", &path)(error.error))?;
    sync_folder(data_dir)
}

/// The owner's name of an earlier attempt to move to a bucket, or a new one.
pub(super) fn kept_owner(data_dir: &Path) -> Result<String> {
    let path = data_dir.join(OWNER);
    match fs::read_to_string(&path) {
        Ok(owner) => Ok(owner),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            let unique = format!("{:?} {} {}", SystemTime::now(), std::process::id(), data_dir.display());
            let owner = blake3::hash(unique.as_bytes()).to_hex().to_string();
            write_file(data_dir, OWNER, owner.as_bytes())?;
            Ok(owner)
        }
        Err(error) => Err(fault("reading", &path)(error)),
    }
}
