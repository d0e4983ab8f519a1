//! The operator's rules for calls of other servers: the hosts, their tokens, the authorities of their certificates.

use std::path::PathBuf;

use gleaner_core::{Error, Result, Secret};
use tokio_rustls::rustls::{
    ClientConfig, RootCertStore,
    crypto::ring,
    pki_types::{CertificateDer, pem::PemObject as _},
};

use crate::address::Address;

/// The rules of one server. By default no host may be called.
#[derive(Debug, Clone, Default)]
pub struct Outgoing {
    /// The hosts that may be called.
    pub hosts: Hosts,
    /// A file with a line `HOST:PORT TOKEN` for each server that requires a token.
    pub tokens: Option<PathBuf>,
    /// Certificates in PEM form, one of which must have signed those of encrypted servers; `None`: the system's.
    pub ca: Option<PathBuf>,
}

/// The hosts that may be called.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Hosts(Vec<(String, Option<u16>)>);

impl Hosts {
    /// Reads entries `HOST` or `HOST:PORT`; an address of IPv6 with a port is in brackets.
    ///
    /// # Errors
    /// A sentence that names the entry.
    pub fn parse(entries: &[String]) -> std::result::Result<Self, String> {
        entries.iter().map(|entry| host(entry.trim())).collect::<std::result::Result<_, _>>().map(Self)
    }

    fn allow(&self, address: &Address) -> bool {
        self.0.iter().any(|(host, port)| *host == address.host && port.is_none_or(|port| port == address.port))
    }
}

fn host(entry: &str) -> std::result::Result<(String, Option<u16>), String> {
    let wrong =
        || format!("{entry:?} is not a host: write HOST or HOST:PORT, such as gpu.lab:8001, [::1]:8000 or 10.0.0.5");
    if entry.parse::<std::net::Ipv6Addr>().is_ok() {
        return Ok((entry.to_ascii_lowercase(), None));
    }
    let (host, port) = match entry.rsplit_once(':') {
        Some((host, port)) => (host, Some(port.parse().map_err(|_| wrong())?)),
        None => (entry, None),
    };
    let host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
    let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_' | ':');
    if host.is_empty() || !host.chars().all(fits) {
        return Err(wrong());
    }
    Ok((host.to_ascii_lowercase(), port))
}

impl Outgoing {
    /// Checks that a server may be called.
    ///
    /// # Errors
    /// Precondition naming the option.
    pub(crate) fn permit(&self, address: &Address) -> Result<()> {
        if self.hosts.allow(address) {
            return Ok(());
        }
        let Address { host, port, .. } = address;
        Err(Error::precondition(format!(
            "this server may not connect to {host}:{port}; start it with --policy-servers {host}:{port}"
        )))
    }

    /// The token for a server. The file is read again for each connection, so that a new token needs no restart.
    ///
    /// # Errors
    /// Precondition when the file cannot be read, or the token would be sent without encryption.
    pub(crate) async fn token(&self, address: &Address) -> Result<Option<Secret>> {
        let Some(path) = &self.tokens else { return Ok(None) };
        let unreadable =
            |problem: String| Error::precondition(format!("--policy-server-tokens {}: {problem}", path.display()));
        let text = tokio::fs::read_to_string(path).await.map_err(|error| unreadable(error.to_string()))?;
        for (at, line) in text.lines().map(str::trim).enumerate() {
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            // The line itself is never repeated: it holds a secret.
            let malformed = || unreadable(format!("line {} is not HOST:PORT TOKEN", at + 1));
            let (entry, token) = line.split_once(char::is_whitespace).ok_or_else(malformed)?;
            let (host, port) = host(entry).map_err(|_| malformed())?;
            let token = token.trim();
            if token.is_empty() || !token.chars().all(|c| c.is_ascii_graphic()) {
                return Err(malformed());
            }
            if host != address.host || port.is_some_and(|port| port != address.port) {
                continue;
            }
            if !address.encrypted && !address.is_loopback() {
                return Err(Error::precondition(format!(
                    "{}: the token of this server would be sent without encryption; register the policy with an \
                     encrypted address (https:// or wss://)",
                    address.text
                )));
            }
            return Ok(Some(Secret::from(token.to_owned())));
        }
        Ok(None)
    }

    /// The certificates of `ca`.
    ///
    /// # Errors
    /// Precondition naming the file.
    pub(crate) async fn authorities(&self) -> Result<Option<Vec<u8>>> {
        let Some(path) = &self.ca else { return Ok(None) };
        tokio::fs::read(path)
            .await
            .map(Some)
            .map_err(|error| Error::precondition(format!("--policy-server-ca {}: {error}", path.display())))
    }

    /// The settings of an encrypted connection that is not gRPC.
    ///
    /// # Errors
    /// Precondition when no authority can be read.
    pub(crate) async fn tls(&self) -> Result<ClientConfig> {
        let given = self.authorities().await?;
        let wrong = |problem: String| Error::precondition(format!("certificates of authorities: {problem}"));
        let roots = tokio::task::spawn_blocking(move || roots(given.as_deref())).await;
        let roots = roots.map_err(|error| wrong(error.to_string()))?.map_err(wrong)?;
        let builder = ClientConfig::builder_with_provider(ring::default_provider().into());
        let builder = builder.with_safe_default_protocol_versions().map_err(|error| wrong(error.to_string()))?;
        Ok(builder.with_root_certificates(roots).with_no_client_auth())
    }
}

/// The given authorities, or those of the system.
fn roots(given: Option<&[u8]>) -> std::result::Result<RootCertStore, String> {
    let certificates = match given {
        Some(pem) => CertificateDer::pem_slice_iter(pem)
            .collect::<std::result::Result<Vec<_>, _>>()
            .map_err(|error| format!("--policy-server-ca: {error}"))?,
        None => rustls_native_certs::load_native_certs().certs,
    };
    let mut roots = RootCertStore::empty();
    roots.add_parsable_certificates(certificates);
    if roots.is_empty() {
        return Err("none found; name a file with --policy-server-ca".to_owned());
    }
    Ok(roots)
}

#[cfg(test)]
mod tests {
    use gleaner_core::{error::Kind, remote::Protocol};

    use super::*;

    fn hosts(entries: &[&str]) -> std::result::Result<Hosts, String> {
        Hosts::parse(&entries.iter().map(|&entry| entry.to_owned()).collect::<Vec<_>>())
    }

    fn address(text: &str) -> Address {
        Address::parse(Protocol::OpenInference, text).unwrap()
    }

    #[test]
    fn only_listed_hosts_are_called() {
        let outgoing =
            Outgoing { hosts: hosts(&["GPU:8001", "10.0.0.5", "[::1]:9", "fe80::1"]).unwrap(), ..Default::default() };
        for allowed in ["http://gpu:8001", "https://10.0.0.5:1", "http://[::1]:9", "http://[fe80::1]:5"] {
            assert!(outgoing.permit(&address(allowed)).is_ok(), "{allowed}");
        }
        for refused in
            ["http://gpu:8002", "http://gpu.evil:8001", "http://10.0.0.50:1", "http://[::1]:10", "http://127.0.0.1:9"]
        {
            let error = outgoing.permit(&address(refused)).unwrap_err();
            assert_eq!(error.kind(), Kind::Precondition);
            assert!(error.message().contains("--policy-servers"), "{error}");
        }
        assert!(Outgoing::default().permit(&address("http://127.0.0.1:9")).is_err());
        for wrong in ["", "http://gpu:1", "gpu:x", "gpu:99999", "a b", "*"] {
            assert!(hosts(&[wrong]).unwrap_err().contains("HOST:PORT"), "{wrong}");
        }
    }

    #[tokio::test]
    async fn a_token_belongs_to_one_host_and_is_never_shown() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens");
        std::fs::write(&path, "# servers\n\nlocalhost:7 first-secret\ngpu second-secret\n").unwrap();
        let outgoing = Outgoing { tokens: Some(path.clone()), ..Default::default() };
        let token = async |text: &str| {
            outgoing.token(&address(text)).await.map(|token| token.map(|token| token.reveal().to_owned()))
        };
        assert_eq!(token("http://localhost:7").await.unwrap().as_deref(), Some("first-secret"));
        assert_eq!(token("http://localhost:8").await.unwrap(), None);
        assert_eq!(token("https://gpu:1").await.unwrap().as_deref(), Some("second-secret"));
        let plain = token("http://gpu:1").await.unwrap_err();
        assert!(plain.message().contains("without encryption") && !plain.message().contains("secret"), "{plain}");
        std::fs::write(&path, "localhost:7secret\n").unwrap();
        let malformed = token("http://localhost:7").await.unwrap_err();
        assert!(malformed.message().contains("line 1") && !malformed.message().contains("7secret"), "{malformed}");
        std::fs::remove_file(&path).unwrap();
        assert!(token("http://localhost:7").await.unwrap_err().message().starts_with("--policy-server-tokens "));
    }
}
