//! The database of a data folder: SQLite in the folder, or PostgreSQL.

use std::{
    fmt,
    net::SocketAddr,
    path::{Path, PathBuf},
};

use super::Postgres;
use crate::{config::DatabaseConfig, data_folder, error::Result};

/// A data folder and its database.
#[derive(Debug, Clone)]
pub(crate) struct Database {
    pub(crate) data_dir: PathBuf,
    /// The database in PostgreSQL; `None`: SQLite in the folder.
    pub(crate) postgres: Option<Postgres>,
}

impl Database {
    /// SQLite in a data folder.
    pub(crate) fn in_folder(data_dir: &Path) -> Self {
        Self { data_dir: data_dir.to_owned(), postgres: None }
    }

    /// The configured database of a data folder.
    ///
    /// # Errors
    /// Invalid names the flag.
    pub(crate) fn configured(data_dir: &Path, config: &DatabaseConfig) -> Result<Self> {
        Ok(Self { data_dir: data_dir.to_owned(), postgres: Postgres::configured(config)? })
    }

    /// The same for the server that listens on this address.
    pub(crate) fn of_server(self, listen: SocketAddr) -> Self {
        Self { postgres: self.postgres.map(|at| at.of_server(listen)), ..self }
    }
}

impl fmt::Display for Database {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.postgres {
            None => write!(f, "{}", data_folder::database(&self.data_dir).display()),
            Some(at) => write!(f, "{at}"),
        }
    }
}
