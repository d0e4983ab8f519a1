//! The folder that certificates are made in: an authority, a server's certificate, those of clients. Keys are readable by
//! their owner only, and no file is replaced unless requested.

use std::{
    fs::{self, DirBuilder, File, Permissions},
    io::Write as _,
    os::unix::fs::{DirBuilderExt as _, PermissionsExt as _},
    path::{Path, PathBuf},
};

use super::issue::Issued;
use crate::error::{Error, Result};

/// The owner of a certificate.
#[derive(Debug, Clone, Copy)]
pub(super) enum Owner<'a> {
    Authority,
    Server,
    Client(&'a str),
}

/// The folder.
#[derive(Debug)]
pub(super) struct Folder(PathBuf);

impl Folder {
    /// The folder at this path, which may not exist yet.
    pub(super) fn at(path: PathBuf) -> Self {
        Self(path)
    }

    /// Creates the folder, readable by its owner only. An existing one is unchanged.
    ///
    /// # Errors
    /// Internal when the disk rejects a write.
    pub(super) fn create(&self) -> Result<()> {
        let created = match self.0.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => fs::create_dir_all(parent),
            Some(_) | None => Ok(()),
        };
        let created = created.and_then(|()| match DirBuilder::new().mode(0o700).create(&self.0) {
            Err(_) if self.0.is_dir() => Ok(()),
            created => created,
        });
        created.map_err(|error| Error::internal(format!("making the folder {}", self.0.display()), error))
    }

    pub(super) fn cert(&self, owner: Owner<'_>) -> PathBuf {
        self.0.join(match owner {
            Owner::Authority => "ca.pem".to_owned(),
            Owner::Server => "server.pem".to_owned(),
            Owner::Client(name) => format!("client-{name}.pem"),
        })
    }

    pub(super) fn key(&self, owner: Owner<'_>) -> PathBuf {
        self.cert(owner).with_extension("key")
    }

    /// An existing file that a new certificate of `owner` would replace.
    pub(super) fn existing(&self, owner: Owner<'_>) -> Option<PathBuf> {
        [self.cert(owner), self.key(owner)].into_iter().find(|path| path.symlink_metadata().is_ok())
    }

    /// Reads a file.
    ///
    /// # Errors
    /// Precondition that names the file.
    pub(super) fn read(&self, path: &Path) -> Result<String> {
        fs::read_to_string(path).map_err(|error| {
            let folder = self.0.display();
            Error::precondition(format!(
                "{}: {error}; make an authority with `gleaner-server tls init`, or name its folder with --out (now {folder})",
                path.display()
            ))
        })
    }

    /// Writes a certificate and its key, in one step each, the key first.
    ///
    /// # Errors
    /// Exists when a file exists and must not be replaced; Internal when the disk rejects a write.
    pub(super) fn write(&self, owner: Owner<'_>, issued: &Issued, replace: bool) -> Result<()> {
        self.put(&self.key(owner), &issued.key, 0o600, replace)?;
        self.put(&self.cert(owner), &issued.cert, 0o644, replace)
    }

    fn put(&self, path: &Path, content: &str, mode: u32, replace: bool) -> Result<()> {
        let failed = |error| Error::internal(format!("writing {}", path.display()), error);
        // Made readable by its owner alone, so that a key is never open to others, however short.
        let mut draft = tempfile::NamedTempFile::new_in(&self.0).map_err(failed)?;
        draft.write_all(content.as_bytes()).map_err(failed)?;
        draft.as_file().set_permissions(Permissions::from_mode(mode)).map_err(failed)?;
        draft.as_file().sync_all().map_err(failed)?;
        let persisted = if replace { draft.persist(path) } else { draft.persist_noclobber(path) };
        persisted.map_err(|refused| {
            if refused.error.kind() == std::io::ErrorKind::AlreadyExists {
                Error::exists(format!("{} exists already", path.display()))
            } else {
                failed(refused.error)
            }
        })?;
        File::open(&self.0).and_then(|folder| folder.sync_all()).map_err(failed)
    }
}
