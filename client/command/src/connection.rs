//! The connection that the global options describe: its arguments, and how it is opened.
//!
//! Must not depend on the commands.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::Args;
use gleaner_client::{Client, ClientError, Credentials, Token};
use tokio::process::Command;

use crate::failure::{Failure, Result};

const DEFAULT_SERVER: &str = "http://127.0.0.1:7400";

/// The variables that options default to.
const SERVER: &str = "GLEANER_SERVER";
const TOKEN: &str = "GLEANER_TOKEN";
const CA: &str = "GLEANER_CA";
const CLIENT_CERT: &str = "GLEANER_CLIENT_CERT";
const CLIENT_KEY: &str = "GLEANER_CLIENT_KEY";

/// The heading of options that every command has.
pub(crate) const GLOBAL: &str = "Global options";

/// The server, and the identity of the caller.
#[derive(Args, Debug)]
pub(crate) struct ConnectionArgs {
    /// Address of the server. Default: http://127.0.0.1:7400.
    #[arg(long, global = true, help_heading = GLOBAL, env = SERVER, value_name = "URL")]
    server: Option<String>,

    /// Access token, for servers that require one.
    #[arg(long, global = true, help_heading = GLOBAL, env = TOKEN, hide_env_values = true)]
    token: Option<Token>,

    /// Certificates (PEM) of authorities to trust, for https:// addresses. Default: those of the system.
    #[arg(long, global = true, help_heading = GLOBAL, env = CA, value_name = "FILE")]
    ca: Option<PathBuf>,

    /// Client certificate (PEM), for servers that require one.
    #[arg(long, global = true, help_heading = GLOBAL, env = CLIENT_CERT, value_name = "FILE",
          requires = "client_key")]
    client_cert: Option<PathBuf>,

    /// Private key (PEM) of the client certificate.
    #[arg(long, global = true, help_heading = GLOBAL, env = CLIENT_KEY, value_name = "FILE",
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

    /// The server, and the caller's credentials, for a process that this one starts.
    pub(crate) fn reach(&self) -> Reach {
        let ConnectionArgs { server: _, token, ca, client_cert, client_key, author: _ } = self;
        let file = |path: &Option<PathBuf>| path.as_ref().map(|path| path.clone().into_os_string());
        let token = token.as_ref().map(|token| token.word().into());
        Reach { url: self.url().to_owned(), credentials: [token, file(ca), file(client_cert), file(client_key)] }
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

/// How a process that this one starts connects: the address, and what the variables of credentials hold.
pub(crate) struct Reach {
    pub(crate) url: String,
    /// Token, authorities, client certificate and its key.
    credentials: [Option<OsString>; 4],
}

impl Reach {
    /// A server that asks for no credentials.
    pub(crate) fn open(url: &str) -> Self {
        Self { url: url.to_owned(), credentials: [const { None }; 4] }
    }

    /// Sets the variables of a command, and removes those that do not belong to this server. They are no arguments, which
    /// other users of the machine could read.
    pub(crate) fn apply(&self, command: &mut Command) {
        command.env(SERVER, &self.url);
        for (name, value) in [TOKEN, CA, CLIENT_CERT, CLIENT_KEY].into_iter().zip(&self.credentials) {
            match value {
                Some(value) => command.env(name, value),
                None => command.env_remove(name),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Options {
        #[command(flatten)]
        connection: ConnectionArgs,
    }

    #[tokio::test]
    async fn a_process_gets_the_credentials_of_its_server_alone() {
        let given = ["gleaner", "--server", "https://lab:7400", "--token", "t0ken", "--ca", "ca.pem"];
        let lab = Options::parse_from(given).connection.reach();
        for (server, connects) in [
            (lab, "https://lab:7400 t0ken ca.pem none\n"),
            (Reach::open("http://127.0.0.1:9"), "http://127.0.0.1:9 none none none\n"),
        ] {
            let shown = format!("echo ${SERVER} ${{{TOKEN}-none}} ${{{CA}-none}} ${{{CLIENT_KEY}-none}}");
            let mut command = Command::new("sh");
            command.args(["-c", &shown]).env(TOKEN, "of another server");
            server.apply(&mut command);
            let output = command.output().await.unwrap();
            assert_eq!(String::from_utf8(output.stdout).unwrap(), connects);
        }
    }
}
