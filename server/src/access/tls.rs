//! Certificates: the files that the edge reads, the reasons for which clients reject them, and the command that creates
//! them. Must not depend on connections; the handshake is the edge's.

pub mod command;
mod folder;
mod issue;
mod parsed;

use std::{path::PathBuf, sync::Arc};

use gleaner_edge::{Tls, TlsFiles};

use self::parsed::Parsed;
use crate::{config::AccessConfig, connections::refused, error::Result};

/// Reads the certificate files, if any are configured.
///
/// # Errors
/// Precondition, naming the flag whose file cannot be used.
pub(crate) fn open(config: &AccessConfig) -> Result<Option<Arc<Tls>>> {
    read(config, config.client_ca.clone())
}

/// As [`open`], for workers: they have the token of their attempt and no certificate.
///
/// # Errors
/// As for [`open`].
pub(crate) fn open_for_workers(config: &AccessConfig) -> Result<Option<Arc<Tls>>> {
    read(config, None)
}

fn read(config: &AccessConfig, client_authority: Option<PathBuf>) -> Result<Option<Arc<Tls>>> {
    let (Some(certificate), Some(key)) = (config.tls_cert.clone(), config.tls_key.clone()) else { return Ok(None) };
    let files = TlsFiles { certificate, key, client_authority };
    Ok(Some(Arc::new(Tls::open(files, problems).map_err(refused)?)))
}

/// The reasons for which clients reject a server with this certificate, now or soon.
fn problems(der: &[u8]) -> Vec<String> {
    match Parsed::der(der) {
        Ok(parsed) => parsed.warnings(jiff::Timestamp::now()),
        Err(problem) => vec![format!("it {problem}")],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Kind;

    #[test]
    fn certificates_are_read_only_when_configured_and_named_by_their_flag() {
        let config = AccessConfig {
            require_tokens: None,
            tls_cert: Some("/nowhere/cert.pem".into()),
            tls_key: Some("/nowhere/key.pem".into()),
            client_ca: None,
        };
        let error = open(&config).err().unwrap();
        assert_eq!(error.kind(), Kind::Precondition);
        assert!(error.message().starts_with("--tls-cert /nowhere/cert.pem: "), "{error}");
        assert!(open(&AccessConfig { tls_cert: None, ..config }).unwrap().is_none());
    }
}
