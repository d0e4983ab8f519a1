//! The credentials of a client, and the authorities that it trusts.

use std::fmt;

use tonic::transport::{Certificate, ClientTlsConfig, Identity};

use crate::error::{ClientError, Result};
use crate::token::Token;

/// The credentials of a client, and the authorities that it trusts. None by default, which is enough for a server on the
/// same machine.
#[derive(Clone, Default)]
pub struct Credentials {
    /// The access token, for servers that require one.
    pub token: Option<Token>,
    /// Certificates in PEM form, one of which must have signed the server's. Without them, the system's are used.
    pub ca: Option<Vec<u8>>,
    /// The client's certificate and its private key, both in PEM form, for servers that require one.
    pub identity: Option<(Vec<u8>, Vec<u8>)>,
}

impl Credentials {
    /// A token alone.
    #[must_use]
    pub fn of(token: Option<Token>) -> Self {
        Self { token, ..Self::default() }
    }

    // The settings of an `https://` address; `None` for `http://`.
    pub(crate) fn tls(&self, url: &str) -> Result<Option<ClientTlsConfig>> {
        if url.starts_with("http://") {
            if self.ca.is_some() || self.identity.is_some() {
                return Err(ClientError::Invalid(format!(
                    "server address {url}: certificates are for encrypted connections; write https://"
                )));
            }
            return Ok(None);
        }
        if !url.starts_with("https://") {
            return Err(ClientError::Invalid(format!(
                "server address {url}: it must begin with http://, or with https:// for an encrypted connection"
            )));
        }
        let mut tls = match &self.ca {
            Some(pem) => ClientTlsConfig::new().ca_certificate(Certificate::from_pem(pem)),
            None => ClientTlsConfig::new().with_native_roots(),
        };
        if let Some((cert, key)) = &self.identity {
            tls = tls.identity(Identity::from_pem(cert, key));
        }
        Ok(Some(tls))
    }
}

impl fmt::Debug for Credentials {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Credentials")
            .field("token", &self.token)
            .field("ca", &self.ca.is_some())
            .field("identity", &self.identity.is_some())
            .finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn certificates_need_an_encrypted_connection() {
        let plain = Credentials::of(Some("secret123".parse().unwrap()));
        assert!(plain.tls("http://lab:7400").unwrap().is_none());
        assert!(plain.tls("https://lab:7400").unwrap().is_some());
        assert!(plain.tls("lab:7400").unwrap_err().to_string().contains("https://"));
        let shown = Credentials { ca: Some(b"pem".to_vec()), ..Credentials::default() };
        assert!(shown.tls("http://lab:7400").unwrap_err().to_string().contains("https://"));
        assert!(shown.tls("https://lab:7400").unwrap().is_some());
    }

    #[test]
    fn debug_output_hides_secrets() {
        let identity = Some((b"certificate".to_vec(), b"private".to_vec()));
        let shown = format!("{:?}", Credentials { token: Some("secret123".parse().unwrap()), ca: None, identity });
        assert!(!shown.contains("secret123") && !shown.contains("private") && !shown.contains("112"), "{shown}");
    }
}
