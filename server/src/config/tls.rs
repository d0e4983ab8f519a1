//! Arguments of `tls`: folder, names and validity of certificates.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// Longest validity that Apple's systems accept of a server certificate, in days.
const SERVER_DAYS: u32 = 825;

/// Arguments of `tls`.
#[derive(Debug, Clone, Args)]
pub struct TlsConfig {
    /// The action.
    #[command(subcommand)]
    pub command: TlsCommand,
}

/// Actions on certificates.
#[derive(Debug, Clone, Subcommand)]
pub enum TlsCommand {
    /// Create a private authority and a server certificate signed by it. Existing files are not replaced.
    Init {
        /// Names, validity and folder.
        #[command(flatten)]
        server: TlsServerConfig,
        /// Replace an existing authority and its server certificate; every client then needs the new ca.pem.
        #[arg(long)]
        overwrite: bool,
    },
    /// Create a new server certificate signed by the existing authority. Clients need no change, and a running server
    /// reads it within seconds.
    Renew(TlsServerConfig),
    /// Create a certificate for one client, for servers that require one (--client-ca).
    Client(TlsClientConfig),
}

/// Folder of the certificates.
#[derive(Debug, Clone, Args)]
pub struct TlsFolderConfig {
    /// Data folder of the server.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data", value_name = "DIR")]
    pub data_dir: PathBuf,
    /// Folder of the certificates and keys. Default: `tls` in the data folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

impl TlsFolderConfig {
    /// The folder of the certificates.
    pub fn path(&self) -> PathBuf {
        self.out.clone().unwrap_or_else(|| self.data_dir.join("tls"))
    }
}

/// A server certificate to create.
#[derive(Debug, Clone, Args)]
pub struct TlsServerConfig {
    /// Where certificates are kept.
    #[command(flatten)]
    pub folder: TlsFolderConfig,
    /// Host name or IP address that clients use for the server; can be repeated. Default: this machine's host name, or
    /// for `renew` the names of the current certificate. localhost, 127.0.0.1 and ::1 are always included.
    #[arg(long = "name", value_name = "HOST")]
    pub names: Vec<String>,
    /// Validity in days, 1 to 3650. Fewer days limit the harm of a stolen key but need renewal more often.
    #[arg(long, default_value_t = SERVER_DAYS, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..=3650))]
    pub days: u32,
}

/// A client certificate to create.
#[derive(Debug, Clone, Args)]
pub struct TlsClientConfig {
    /// Name of the client, such as arm1; part of the file names.
    pub name: String,
    /// Where certificates are kept.
    #[command(flatten)]
    pub folder: TlsFolderConfig,
    /// Validity in days, 1 to 3650. Certificates cannot be revoked one by one, so fewer days are safer.
    #[arg(long, default_value_t = SERVER_DAYS, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..=3650))]
    pub days: u32,
}
