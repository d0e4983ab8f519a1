//! Real handshakes over loopback: with a good certificate, with and without a client's own, and after a change of files.

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair};
use tempfile::TempDir;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpListener,
};
use tokio_rustls::{
    TlsConnector,
    rustls::{ClientConfig, pki_types::ServerName},
};

use super::*;
use crate::error::Kind;

type Authority = CertifiedIssuer<'static, KeyPair>;

fn authority() -> Authority {
    let mut params = CertificateParams::new(Vec::new()).unwrap();
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap()
}

/// A certificate for localhost and its key, as PEM.
fn issue(authority: &Authority) -> (String, String) {
    let key = KeyPair::generate().unwrap();
    let params = CertificateParams::new(vec!["localhost".to_owned()]).unwrap();
    (params.signed_by(&key, authority).unwrap().pem(), key.serialize_pem())
}

struct Bench {
    dir: TempDir,
    authority: Authority,
}

impl Bench {
    fn new() -> Self {
        let bench = Self { dir: tempfile::tempdir().unwrap(), authority: authority() };
        bench.renew();
        std::fs::write(bench.path("ca"), bench.authority.pem()).unwrap();
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// Puts a new certificate and key in place; gives back the certificate.
    fn renew(&self) -> String {
        let (cert, key) = issue(&self.authority);
        std::fs::write(self.path("cert"), &cert).unwrap();
        std::fs::write(self.path("key"), key).unwrap();
        cert
    }

    fn config(&self, client_ca: bool) -> AccessConfig {
        AccessConfig {
            require_tokens: None,
            tls_cert: Some(self.path("cert")),
            tls_key: Some(self.path("key")),
            client_ca: client_ca.then(|| self.path("ca")),
        }
    }

    fn client(&self, identity: Option<(String, String)>) -> TlsConnector {
        let mut roots = RootCertStore::empty();
        roots.add(self.authority.der().clone()).unwrap();
        let builder = ClientConfig::builder_with_provider(Arc::new(crypto::ring::default_provider()))
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots);
        let mut config = match identity {
            None => builder.with_no_client_auth(),
            Some((cert, key)) => {
                let chain = CertificateDer::pem_slice_iter(cert.as_bytes()).map(|cert| cert.unwrap()).collect();
                builder.with_client_auth_cert(chain, PrivateKeyDer::from_pem_slice(key.as_bytes()).unwrap()).unwrap()
            }
        };
        config.alpn_protocols = vec![b"h2".to_vec()];
        TlsConnector::from(Arc::new(config))
    }
}

/// Shakes hands and sends a byte there and back; the certificate that the server showed.
async fn exchange(tls: &Tls, client: &TlsConnector) -> io::Result<CertificateDer<'static>> {
    let listener = TcpListener::bind("127.0.0.1:0").await?;
    let address = listener.local_addr()?;
    let serve = async {
        let mut stream = shake(tls.current(), listener.accept().await?.0).await?;
        let byte = stream.read_u8().await?;
        stream.write_u8(byte).await?;
        stream.flush().await
    };
    let call = async {
        let stream = TcpStream::connect(address).await?;
        let mut stream = client.connect(ServerName::try_from("localhost").unwrap(), stream).await?;
        stream.write_u8(7).await?;
        stream.flush().await?;
        assert_eq!(stream.read_u8().await?, 7);
        let (_, session) = stream.get_ref();
        assert_eq!(session.alpn_protocol(), Some(b"h2".as_slice()));
        Ok(session.peer_certificates().unwrap()[0].clone())
    };
    let (served, called) = tokio::join!(serve, call);
    served.and(called)
}

#[tokio::test]
async fn a_good_certificate_is_accepted_and_a_clients_own_is_asked_for() {
    let bench = Bench::new();
    let open = Tls::open(&bench.config(false)).unwrap().unwrap();
    exchange(&open, &bench.client(None)).await.unwrap();

    let closed = Tls::open(&bench.config(true)).unwrap().unwrap();
    assert!(exchange(&closed, &bench.client(None)).await.is_err(), "no certificate");
    let stranger = issue(&authority());
    assert!(exchange(&closed, &bench.client(Some(stranger))).await.is_err(), "another authority's");
    exchange(&closed, &bench.client(Some(issue(&bench.authority)))).await.unwrap();
    assert!(Tls::open(&AccessConfig { tls_cert: None, ..bench.config(false) }).unwrap().is_none());
}

#[tokio::test]
async fn a_renewed_certificate_is_taken_up_and_a_broken_one_is_not() {
    let bench = Bench::new();
    let tls = Tls::open(&bench.config(false)).unwrap().unwrap();
    let client = bench.client(None);
    let first = exchange(&tls, &client).await.unwrap();
    // Amid a renewal: the new key is not there yet.
    std::fs::write(bench.path("cert"), issue(&bench.authority).0).unwrap();
    assert!(tls.files.read().is_err());
    assert_eq!(exchange(&tls, &client).await.unwrap(), first);
    let renewed = CertificateDer::from_pem_slice(bench.renew().as_bytes()).unwrap();
    let taken_up = async { while exchange(&tls, &client).await.unwrap() != renewed {} };
    tokio::select! {
        () = tls.follow() => {}
        taken_up = tokio::time::timeout(Duration::from_secs(30), taken_up) => taken_up.unwrap(),
    }
}

#[test]
fn a_file_that_is_given_its_old_time_has_changed() {
    let bench = Bench::new();
    let files = Tls::open(&bench.config(false)).unwrap().unwrap().files;
    let (before, cert) = (files.stamps(), bench.path("cert"));
    let written = std::fs::metadata(&cert).unwrap().modified().unwrap();
    let mut content = std::fs::read(&cert).unwrap();
    let begun = std::time::Instant::now();
    // Again, because the system's clock for files has steps.
    while files.stamps() == before {
        assert!(begun.elapsed() < Duration::from_secs(10), "nothing shows");
        content.reverse();
        std::fs::write(&cert, &content).unwrap();
        std::fs::File::options().write(true).open(&cert).unwrap().set_modified(written).unwrap();
    }
}

#[test]
fn files_that_cannot_be_used_are_named_with_their_flag() {
    let bench = Bench::new();
    let refused = |config: &AccessConfig, words: [&str; 2]| {
        let error = Tls::open(config).unwrap_err();
        assert_eq!(error.kind(), Kind::Precondition);
        for word in words {
            assert!(error.message().contains(word), "{word}: {error}");
        }
    };
    let config = bench.config(true);
    refused(&AccessConfig { tls_cert: Some(bench.path("none")), ..config.clone() }, ["--tls-cert", "none"]);
    refused(&AccessConfig { tls_key: Some(bench.path("none")), ..config.clone() }, ["--tls-key", "none"]);
    refused(&AccessConfig { client_ca: Some(bench.path("key")), ..config.clone() }, ["--client-ca", "no certificate"]);
    refused(&AccessConfig { tls_key: Some(bench.path("cert")), ..config.clone() }, ["--tls-key", "no private key"]);
    std::fs::write(bench.path("other"), issue(&bench.authority).1).unwrap();
    refused(&AccessConfig { tls_key: Some(bench.path("other")), ..config }, ["--tls-cert", "does not go with"]);
}
