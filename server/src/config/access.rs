//! Tokens and TLS of the server, and the arguments of `token` and `audit`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::DatabaseConfig;

use crate::domain::access::Role;

/// Tokens and TLS.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Access")]
pub struct AccessConfig {
    /// Require a token from every caller (`gleaner-server token create`). Default: true, but false on a loopback
    /// address and with --insecure.
    #[arg(long, env = "GLEANER_REQUIRE_TOKENS", num_args = 0..=1, require_equals = true, default_missing_value = "true",
          value_name = "BOOL")]
    pub require_tokens: Option<bool>,
    /// Serve TLS with this certificate: a PEM file with the whole chain (`gleaner-server tls init` creates one). It is
    /// read again when it changes, and on SIGHUP.
    #[arg(long, env = "GLEANER_TLS_CERT", value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate: a PEM file.
    #[arg(long, env = "GLEANER_TLS_KEY", value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// Accept only clients with a certificate signed by one of these authorities: a PEM file. Default: no client
    /// certificates.
    #[arg(long, env = "GLEANER_CLIENT_CA", value_name = "FILE", requires = "tls_cert")]
    pub client_ca: Option<PathBuf>,
}

/// Arguments of `token`.
#[derive(Debug, Clone, Args)]
pub struct TokenConfig {
    /// Data folder of the server, which may be running.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data", global = true, value_name = "DIR")]
    pub data_dir: PathBuf,
    /// The database.
    #[command(flatten)]
    pub database: DatabaseConfig,
    /// The action.
    #[command(subcommand)]
    pub command: TokenCommand,
}

/// Actions on tokens.
#[derive(Debug, Clone, Subcommand)]
pub enum TokenCommand {
    /// Create a token. It is printed once; only its hash is stored.
    Create(NewTokenConfig),
    /// List tokens with their last use.
    List,
    /// Revoke a token. A running server rejects it within seconds and ends its open calls.
    Revoke {
        /// Id or name of the token.
        token: String,
    },
}

/// Arguments of `token create`.
#[derive(Debug, Clone, Args)]
pub struct NewTokenConfig {
    /// Role: viewer, contributor, trainer, robot or admin.
    #[arg(long, value_parser = role, value_name = "ROLE")]
    pub role: Role,
    /// Label shown in `token list` and in the audit log.
    #[arg(long, default_value = "", hide_default_value = true)]
    pub name: String,
    /// Deployment that a robot may use; can be repeated.
    #[arg(long = "deployment", value_name = "NAME")]
    pub deployments: Vec<String>,
    /// Validity, such as 30d or 12h. Default: valid until revoked.
    #[arg(long, value_name = "TIME")]
    pub expires: Option<String>,
}

/// Arguments of `audit`.
#[derive(Debug, Clone, Args)]
pub struct AuditConfig {
    /// Data folder of the server, which may be running.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data", value_name = "DIR")]
    pub data_dir: PathBuf,
    /// Print entries since an age such as 7d or 12h, a day such as 2026-11-20, or a time such as 2026-11-20T08:00:00Z.
    #[arg(long, default_value = "7d", value_name = "TIME")]
    pub since: String,
    /// Maximum number of entries; the newest are printed.
    #[arg(long, default_value_t = 1000, value_name = "N")]
    pub limit: u32,
    /// The database.
    #[command(flatten)]
    pub database: DatabaseConfig,
}

fn role(word: &str) -> Result<Role, String> {
    let words = || Role::ALL.map(Role::as_str).join(", ");
    Role::from_word(word).ok_or_else(|| format!("must be one of {}", words()))
}

impl AccessConfig {
    /// Whether callers must show a token, at an address that is loopback or not.
    pub fn tokens_required(&self, loopback: bool, insecure: bool) -> bool {
        self.require_tokens.unwrap_or(!loopback && !insecure)
    }

    /// Checks that an address which other machines can reach has TLS and tokens.
    ///
    /// # Errors
    /// A sentence that names the flag and the fix.
    pub fn validate(&self, listen: std::net::SocketAddr, insecure: bool) -> Result<(), String> {
        let loopback = listen.ip().is_loopback();
        let missing = match (self.tls_cert.is_some(), self.tokens_required(loopback, insecure)) {
            _ if loopback || insecure => return Ok(()),
            (true, true) => return Ok(()),
            (false, _) => "encrypt with --tls-cert and --tls-key (`gleaner-server tls init` creates both files)",
            (true, false) => "require tokens with --require-tokens",
        };
        Err(format!(
            "--listen {listen}: other machines can reach this address: {missing}, or listen on 127.0.0.1, or accept the \
             risk with --insecure"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(tls: bool, require_tokens: Option<bool>) -> AccessConfig {
        let file = tls.then(|| PathBuf::from("pem"));
        AccessConfig { require_tokens, tls_cert: file.clone(), tls_key: file, client_ca: None }
    }

    #[test]
    fn public_address_requires_tls_and_tokens_unless_insecure() {
        let (near, far) = (([127, 0, 0, 1], 7400).into(), ([0, 0, 0, 0], 7400).into());
        for (tls, tokens, flag) in [
            (true, None, None),
            (true, Some(true), None),
            (true, Some(false), Some("--require-tokens")),
            (false, None, Some("--tls-cert")),
            (false, Some(true), Some("--tls-cert")),
        ] {
            let config = config(tls, tokens);
            assert_eq!(config.validate(near, false), Ok(()));
            assert_eq!(config.validate(far, true), Ok(()));
            let problem = config.validate(far, false).err();
            assert_eq!(problem.is_some(), flag.is_some(), "{tls} {tokens:?}");
            if let (Some(problem), Some(flag)) = (problem, flag) {
                assert!(problem.contains(flag) && problem.contains("--insecure"), "{problem}");
            }
        }
    }

    #[test]
    fn tokens_are_required_on_public_addresses_by_default() {
        for (required, loopback, insecure, expected) in [
            (None, true, false, false),
            (None, false, false, true),
            (None, false, true, false),
            (Some(true), true, false, true),
            (Some(true), false, true, true),
            (Some(false), false, false, false),
        ] {
            assert_eq!(config(true, required).tokens_required(loopback, insecure), expected);
        }
    }
}
