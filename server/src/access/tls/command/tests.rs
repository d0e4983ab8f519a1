//! Certificates of the command, tried with the TLS of the server and of a client, and its rejections.

use std::{os::unix::fs::PermissionsExt as _, path::PathBuf, sync::Arc, time::Duration};

use clap::Parser as _;
use gleaner_edge::{Protocol, Tls};
use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, RootCertStore, crypto,
        pki_types::{CertificateDer, PrivateKeyDer, ServerName, pem::PemObject as _},
    },
};
use x509_parser::prelude::{FromDer as _, X509Certificate};

use super::*;
use crate::{
    access::tls,
    config::{AccessConfig, Cli, Command},
    error::Kind,
};

struct Lab(tempfile::TempDir);

impl Lab {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn with(words: &[&str]) -> Self {
        let lab = Self::new();
        lab.tls(&[&["init"], words].concat()).unwrap();
        lab
    }

    /// Runs `gleaner-server tls …` and returns its output.
    fn tls(&self, words: &[&str]) -> Result<String> {
        let data = self.0.path().join("lab");
        let all = [&["gleaner-server", "tls"], words, &["--data-dir", data.to_str().unwrap()]].concat();
        let Command::Tls(config) = Cli::try_parse_from(all).unwrap().command else { unreachable!() };
        let mut out = Vec::new();
        run(&config, &mut out)?;
        Ok(String::from_utf8(out).unwrap())
    }

    fn file(&self, name: &str) -> PathBuf {
        self.0.path().join("lab/tls").join(name)
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.file(name)).unwrap()
    }

    fn der(&self, name: &str) -> CertificateDer<'static> {
        CertificateDer::from_pem_file(self.file(name)).unwrap()
    }

    fn serves(&self, client_ca: bool) -> Arc<Tls> {
        let config = AccessConfig {
            require_tokens: None,
            tls_cert: Some(self.file("server.pem")),
            tls_key: Some(self.file("server.key")),
            client_ca: client_ca.then(|| self.file("ca.pem")),
        };
        tls::open(&config).unwrap().unwrap()
    }

    /// Shakes hands with a server as this name, as a client that trusts `ca`, with the certificate `own` if any.
    async fn handshake_succeeds(&self, tls: &Tls, name: &str, ca: &CertificateDer<'static>, own: Option<&str>) -> bool {
        let mut roots = RootCertStore::empty();
        roots.add(ca.clone()).unwrap();
        let client = ClientConfig::builder_with_provider(Arc::new(crypto::ring::default_provider()))
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots);
        let mut client = match own {
            None => client.with_no_client_auth(),
            Some(own) => {
                let key = PrivateKeyDer::from_pem_file(self.file(&format!("{own}.key"))).unwrap();
                client.with_client_auth_cert(vec![self.der(&format!("{own}.pem"))], key).unwrap()
            }
        };
        client.alpn_protocols = vec![b"h2".to_vec()];
        let (near, far) = tokio::io::duplex(1 << 16);
        let name = ServerName::try_from(name.to_owned()).unwrap();
        let (called, served) =
            tokio::join!(TlsConnector::from(Arc::new(client)).connect(name, near), tls.accept(Protocol::Http2, far));
        called.is_ok() && served.is_ok()
    }
}

#[tokio::test]
async fn a_client_with_the_authority_accepts_the_server_under_each_of_its_names_and_no_other() {
    let lab = Lab::with(&["--name", "lab7.example", "--name", "10.0.0.7"]);
    let (tls, ca) = (lab.serves(false), lab.der("ca.pem"));
    for name in ["lab7.example", "10.0.0.7", "localhost", "127.0.0.1", "::1"] {
        assert!(lab.handshake_succeeds(&tls, name, &ca, None).await, "{name}");
    }
    assert!(!lab.handshake_succeeds(&tls, "lab8.example", &ca, None).await);
    let stranger = Lab::with(&[]);
    assert!(!lab.handshake_succeeds(&tls, "localhost", &stranger.der("ca.pem"), None).await);
}

#[tokio::test]
async fn renewal_keeps_the_authority_and_the_names_and_changes_the_key() {
    let lab = Lab::with(&["--name", "lab7", "--name", "fd00::7"]);
    let (ca, old_cert, old_key) = (lab.der("ca.pem"), lab.read("server.pem"), lab.read("server.key"));
    let output = lab.tls(&["renew", "--days", "30"]).unwrap();
    assert!(output.contains("lab7, fd00::7, localhost"), "{output}");
    assert_eq!(lab.der("ca.pem"), ca);
    assert!(lab.read("server.pem") != old_cert && lab.read("server.key") != old_key);
    for name in ["lab7", "fd00::7", "127.0.0.1"] {
        assert!(lab.handshake_succeeds(&lab.serves(false), name, &ca, None).await, "{name}");
    }
    lab.tls(&["renew", "--name", "lab9"]).unwrap();
    assert!(lab.handshake_succeeds(&lab.serves(false), "lab9", &ca, None).await);
    assert!(
        !lab.handshake_succeeds(&lab.serves(false), "lab7", &ca, None).await,
        "names that are given replace the old ones"
    );
}

#[tokio::test]
async fn only_client_certificates_are_accepted_as_client_certificates() {
    let lab = Lab::with(&[]);
    let output = lab.tls(&["client", "arm1"]).unwrap();
    assert!(output.contains("client-arm1.pem") && output.contains("--client-ca"), "{output}");
    let (tls, ca) = (lab.serves(true), lab.der("ca.pem"));
    assert!(lab.handshake_succeeds(&tls, "localhost", &ca, Some("client-arm1")).await);
    assert!(!lab.handshake_succeeds(&tls, "localhost", &ca, Some("server")).await, "a server's is for servers");
    let other = lab.tls(&["client", "arm1"]).unwrap_err();
    assert_eq!(other.kind(), Kind::Exists);
}

#[test]
fn keys_are_readable_by_their_owner_only_and_files_are_not_replaced_by_default() {
    let lab = Lab::new();
    let output = lab.tls(&["init", "--name", "lab7"]).unwrap();
    for part in
        ["lab7", "--tls-cert", "server.pem", "--tls-key", "server.key", "GLEANER_CA=ca.pem", "https://lab7:7400"]
    {
        assert!(output.contains(part), "{part}: {output}");
    }
    let mode = |name: &str| std::fs::metadata(lab.file(name)).unwrap().permissions().mode() & 0o777;
    assert_eq!(
        [mode(""), mode("ca.key"), mode("server.key"), mode("ca.pem"), mode("server.pem")],
        [0o700, 0o600, 0o600, 0o644, 0o644]
    );
    let before = lab.read("ca.key");
    let refused = lab.tls(&["init"]).unwrap_err();
    assert_eq!(refused.kind(), Kind::Exists);
    assert!(refused.message().contains("tls renew") && refused.message().contains("--overwrite"), "{refused}");
    assert_eq!(lab.read("ca.key"), before);
    lab.tls(&["init", "--overwrite"]).unwrap();
    assert_ne!(lab.read("ca.key"), before);
    // A key alone is not replaced either.
    std::fs::remove_file(lab.file("ca.pem")).unwrap();
    assert_eq!(lab.tls(&["init"]).unwrap_err().kind(), Kind::Exists);
    let names: Vec<_> = std::fs::read_dir(lab.file("")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names.len(), 3, "no drafts stay: {names:?}");
}

#[test]
fn certificates_have_the_extensions_that_strict_verifiers_require() {
    let lab = Lab::with(&["--name", "lab7"]);
    let (ca, server) = (lab.der("ca.pem"), lab.der("server.pem"));
    let (_, ca) = X509Certificate::from_der(&ca).unwrap();
    let (_, server) = X509Certificate::from_der(&server).unwrap();
    let constraints = ca.basic_constraints().unwrap().unwrap();
    assert!(constraints.critical && constraints.value.ca && constraints.value.path_len_constraint == Some(0));
    assert!(ca.key_usage().unwrap().unwrap().value.key_cert_sign());
    assert!(!server.is_ca() && server.basic_constraints().unwrap().is_some());
    assert!(server.key_usage().unwrap().unwrap().value.digital_signature());
    let usage = server.extended_key_usage().unwrap().unwrap().value;
    assert!(usage.server_auth && !usage.client_auth && !usage.any);
    let extension = |certificate: &X509Certificate<'_>, of: &str| {
        certificate.iter_extensions().any(|extension| extension.oid.to_id_string() == of)
    };
    assert!(extension(&ca, "2.5.29.14") && extension(&server, "2.5.29.35"), "key identifiers");
    for certificate in [&ca, &server] {
        assert!((8..=20).contains(&certificate.raw_serial().len()) && certificate.raw_serial()[0] < 0x80);
        assert_eq!(certificate.public_key().algorithm.algorithm.to_id_string(), "1.2.840.10045.2.1");
    }
    assert_eq!(server.issuer(), ca.subject());
    assert_eq!(server.subject_alternative_name().unwrap().unwrap().value.general_names.len(), 4);
}

#[test]
fn unusable_certificates_are_rejected_with_the_fix() {
    let lab = Lab::new();
    let refused = |words: &[&str], kind: Kind, part: &str| {
        let error = lab.tls(words).unwrap_err();
        assert!(error.kind() == kind && error.message().contains(part), "{words:?}: {error}");
    };
    for name in ["https://lab", "lab:7400", "", "a b", "lab-", "lab..example", "größe", "../x", "\u{202e}"] {
        refused(&["init", "--name", name], Kind::Invalid, "--name");
    }
    refused(&["renew"], Kind::Precondition, "tls init");
    refused(&["client", "arm1"], Kind::Precondition, "tls init");
    assert!(!lab.file("").exists(), "no certificate was created");
    lab.tls(&["init"]).unwrap();
    for name in ["", "../arm", "a/b", "a b", "\u{1b}"] {
        refused(&["client", name], Kind::Invalid, "NAME");
    }
    std::fs::write(lab.file("ca.key"), lab.read("server.key")).unwrap();
    refused(&["renew"], Kind::Precondition, "do not belong together");
    std::fs::write(lab.file("ca.pem"), lab.read("server.pem")).unwrap();
    refused(&["renew"], Kind::Precondition, "not that of an authority");
    std::fs::write(lab.file("ca.pem"), "nothing").unwrap();
    refused(&["renew"], Kind::Precondition, "ca.pem");
}

#[test]
fn a_certificate_ends_with_its_authority_and_an_expired_authority_signs_nothing() {
    let now = SystemTime::now();
    let (_, kept) = Authority::new(now).unwrap();
    let after = |days: u64| now + Duration::from_secs(days * 24 * 60 * 60);
    let late = Authority::read(&kept.cert, &kept.key, after(3600)).unwrap();
    let names = [server_name("lab7").unwrap()];
    assert_eq!(late.server(&names, 825, after(3600)).unwrap().expires, kept.expires);
    assert!(late.server(&names, 10, after(3600)).unwrap().expires < kept.expires);
    let expired = Authority::read(&kept.cert, &kept.key, after(3651)).err().unwrap();
    assert!(expired.contains("expired") && expired.contains("tls init --overwrite"), "{expired}");
}
