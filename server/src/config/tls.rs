//! What `tls` needs: where certificates are kept, for which names, for how long.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// Longest validity that Apple's systems accept of a server certificate, in days.
const SERVER_DAYS: u32 = 825;

/// What to do with certificates.
#[derive(Debug, Clone, Args)]
pub struct TlsConfig {
    /// What to do.
    #[command(subcommand)]
    pub command: TlsCommand,
}

/// What to do with certificates.
#[derive(Debug, Clone, Subcommand)]
pub enum TlsCommand {
    /// Make a private authority and a server certificate signed by it. Refuses to replace existing ones.
    Init {
        /// Names, validity and folder.
        #[command(flatten)]
        server: TlsServerConfig,
        /// Replace an existing authority and its server certificate; every client then needs the new ca.pem.
        #[arg(long)]
        overwrite: bool,
    },
    /// Make a new server certificate signed by the existing authority. Clients need nothing new, and a running server
    /// reads it within seconds.
    Renew(TlsServerConfig),
    /// Make a certificate for one client, for servers that ask for one (--client-ca).
    Client(TlsClientConfig),
}

/// Where certificates are kept.
#[derive(Debug, Clone, Args)]
pub struct TlsFolderConfig {
    /// The server's data folder.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data")]
    pub data_dir: PathBuf,
    /// Folder of the certificates and keys; by default `tls` in the data folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

impl TlsFolderConfig {
    /// The folder of the certificates.
    pub fn path(&self) -> PathBuf {
        self.out.clone().unwrap_or_else(|| self.data_dir.join("tls"))
    }
}

/// A server certificate to make.
#[derive(Debug, Clone, Args)]
pub struct TlsServerConfig {
    /// Where certificates are kept.
    #[command(flatten)]
    pub folder: TlsFolderConfig,
    /// Host name or IP address that clients use for the server; may be given more than once. By default this machine's
    /// host name, or for `renew` the names of the current certificate. localhost, 127.0.0.1 and ::1 are always included.
    #[arg(long = "name", value_name = "HOST")]
    pub names: Vec<String>,
    /// Days that the certificate is valid. Fewer limit the harm of a stolen key but need renewal more often.
    #[arg(long, default_value_t = SERVER_DAYS, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..=3650))]
    pub days: u32,
}

/// A client certificate to make.
#[derive(Debug, Clone, Args)]
pub struct TlsClientConfig {
    /// Name of the client, such as arm1; becomes part of the file names.
    pub name: String,
    /// Where certificates are kept.
    #[command(flatten)]
    pub folder: TlsFolderConfig,
    /// Days that the certificate is valid. Certificates cannot be revoked one by one, so fewer are safer.
    #[arg(long, default_value_t = SERVER_DAYS, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..=3650))]
    pub days: u32,
}
