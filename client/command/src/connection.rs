//! The connection that the global options describe: its arguments, and how it is opened.
//!
//! Must not depend on the commands.

use std::path::{Path, PathBuf};

use clap::Args;
use gleaner_client::{Client, ClientError, Credentials, Token};

use crate::failure::{Failure, Result};

const DEFAULT_SERVER: &str = "http://127.0.0.1:7400";

/// The heading of options that every command has.
pub(crate) const GLOBAL: &str = "Global options";

/// The server, and the identity of the caller.
#[derive(Args, Debug)]
pub(crate) struct ConnectionArgs {
    /// Address of the server. Default: http://127.0.0.1:7400.
    #[arg(long, global = true, help_heading = GLOBAL, env = "GLEANER_SERVER", value_name = "URL")]
    server: Option<String>,

    /// Access token, for servers that require one.
    #[arg(long, global = true, help_heading = GLOBAL, env = "GLEANER_TOKEN", hide_env_values = true)]
    token: Option<Token>,

    /// Certificates (PEM) of authorities to trust, for https:// addresses. Default: those of the system.
    #[arg(long, global = true, help_heading = GLOBAL, env = "GLEANER_CA", value_name = "FILE")]
    ca: Option<PathBuf>,

    /// Client certificate (PEM), for servers that require one.
    #[arg(long, global = true, help_heading = GLOBAL, env = "GLEANER_CLIENT_CERT", value_name = "FILE",
          requires = "client_key")]
    client_cert: Option<PathBuf>,

    /// Private key (PEM) of the client certificate.
    #[arg(long, global = true, help_heading = GLOBAL, env = "GLEANER_CLIENT_KEY", value_name = "FILE",
          requires = "client_cert")]
    client_key: Option<PathBuf>,

    /// Author of labels, kept in their history.
    #[arg(long, global = true, help_heading = GLOBAL, env = "USER", hide_env_values = true, value_name = "NAME")]
    author: Option<String>,
}

impl ConnectionArgs {
    /// The address of the server.
    pub(crate) fn url(&self) -> &str {
        self.server.as_deref().unwrap_or(DEFAULT_SERVER)
    }

    /// Whether the user named a server.
    pub(crate) fn names_server(&self) -> bool {
        self.server.is_some()
    }

    /// The author of labels, as recorded with each label.
    pub(crate) fn author(&self) -> String {
        self.author.clone().unwrap_or_default()
    }

    pub(crate) async fn open(&self) -> Result<Client> {
        Ok(Client::connect_with(self.url(), self.credentials()?).await?)
    }

    /// The failure, with its likely cause where a lost connection hides it: a server that encrypts at an address without
    /// encryption, or one that requires a client certificate (its rejection follows the handshake and may be lost).
    pub(crate) async fn explained(&self, failure: Failure) -> Failure {
        let server = self.url();
        if !failure.is_lost_connection() {
            return failure;
        }
        let message = failure.to_string();
        if server.starts_with("https://") && self.client_cert.is_none() && !message.contains("--client-cert") {
            return Failure::message(format!(
                "{message}; if the server asks for a client certificate, give --client-cert and --client-key"
            ));
        }
        if !Client::encrypts(server).await {
            return failure;
        }
        let address = server.trim_start_matches("http://");
        Failure::message(format!(
            "cannot connect to {server}: this server requires encryption; use https://{address} and name its authority \
             with --ca FILE"
        ))
    }

    // Files are read now, so that a missing one is named.
    fn credentials(&self) -> Result<Credentials> {
        let ConnectionArgs { server: _, token, ca, client_cert, client_key, author: _ } = self;
        let read = |path: &Path| std::fs::read(path).map_err(ClientError::io(path));
        let identity = match (client_cert, client_key) {
            (Some(cert), Some(key)) => Some((read(cert)?, read(key)?)),
            (_, _) => None,
        };
        Ok(Credentials { token: token.clone(), ca: ca.as_deref().map(read).transpose()?, identity })
    }
}
