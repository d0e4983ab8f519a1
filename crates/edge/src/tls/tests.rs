//! Real handshakes over loopback: with a valid certificate, with and without a client's own, and after a change of
//! files.

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

    /// Replaces certificate and key by new ones; returns the certificate.
    fn renew(&self) -> String {
        let (cert, key) = issue(&self.authority);
        std::fs::write(self.path("cert"), &cert).unwrap();
        std::fs::write(self.path("key"), key).unwrap();
        cert
    }

    fn files(&self, client_ca: bool) -> TlsFiles {
        TlsFiles {
            certificate: self.path("cert"),
            key: self.path("key"),
            client_authority: client_ca.then(|| self.path("ca")),
        }
    }

    fn open(&self, client_ca: bool) -> Arc<Tls> {
        Arc::new(open(self.files(client_ca)).unwrap())
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

fn open(files: TlsFiles) -> Result<Tls, EdgeError> {
    Tls::open(files, |_| Vec::new())
}

/// Shakes hands and sends a byte there and back; returns the server's certificate.
async fn exchange(tls: &Arc<Tls>, client: &TlsConnector) -> io::Result<CertificateDer<'static>> {
    let listener = TcpListener::bind("127.0.0.1:0").await?;
    let address = listener.local_addr()?;
    let serve = async {
        let mut stream = tls.accept(Protocol::Http2, listener.accept().await?.0).await?;
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
async fn a_good_certificate_is_accepted_and_a_client_certificate_is_required() {
    let bench = Bench::new();
    let open = bench.open(false);
    exchange(&open, &bench.client(None)).await.unwrap();

    let closed = bench.open(true);
    assert!(exchange(&closed, &bench.client(None)).await.is_err(), "no certificate");
    let stranger = issue(&authority());
    assert!(exchange(&closed, &bench.client(Some(stranger))).await.is_err(), "another authority's");
    exchange(&closed, &bench.client(Some(issue(&bench.authority)))).await.unwrap();
}

#[tokio::test]
async fn a_renewed_certificate_is_used_and_a_broken_one_is_not() {
    let bench = Bench::new();
    let tls = bench.open(false);
    let client = bench.client(None);
    let first = exchange(&tls, &client).await.unwrap();
    // In the middle of a renewal: the new key is not written yet.
    std::fs::write(bench.path("cert"), issue(&bench.authority).0).unwrap();
    assert!(tls.files.read(|_| Vec::new()).is_err());
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
    let files = bench.files(false);
    let (before, cert) = (files.stamps(), bench.path("cert"));
    let written = std::fs::metadata(&cert).unwrap().modified().unwrap();
    let mut content = std::fs::read(&cert).unwrap();
    let begun = std::time::Instant::now();
    // Repeated, because the file system's clock is coarse.
    while files.stamps() == before {
        assert!(begun.elapsed() < Duration::from_secs(10), "nothing shows");
        content.reverse();
        std::fs::write(&cert, &content).unwrap();
        std::fs::File::options().write(true).open(&cert).unwrap().set_modified(written).unwrap();
    }
}

#[test]
fn unusable_files_are_named() {
    let bench = Bench::new();
    let refused = |files: TlsFiles, (expected, words): (TlsFile, [&str; 2])| {
        let error = open(files).unwrap_err();
        let EdgeError::Certificate { file, path, problem } = error else { panic!("{error}") };
        assert_eq!(file, expected);
        let (path, [name, word]) = (path.display().to_string(), words);
        assert!(path.ends_with(name) && problem.contains(word), "{path}: {problem}");
    };
    let (files, path) = (bench.files(true), |name: &str| bench.path(name));
    refused(TlsFiles { certificate: path("none"), ..files.clone() }, (TlsFile::Certificate, ["none", ""]));
    refused(TlsFiles { key: path("none"), ..files.clone() }, (TlsFile::Key, ["none", ""]));
    let authority = TlsFiles { client_authority: Some(path("key")), ..files.clone() };
    refused(authority, (TlsFile::ClientAuthority, ["key", "no certificate"]));
    refused(TlsFiles { key: path("cert"), ..files.clone() }, (TlsFile::Key, ["cert", "no private key"]));
    std::fs::write(path("other"), issue(&bench.authority).1).unwrap();
    refused(TlsFiles { key: path("other"), ..files }, (TlsFile::Certificate, ["cert", "does not go with"]));
}

#[test]
fn problems_of_a_certificate_do_not_keep_it_from_being_used() {
    let bench = Bench::new();
    Tls::open(bench.files(false), |der| vec![format!("{} bytes", der.len())]).unwrap();
}
