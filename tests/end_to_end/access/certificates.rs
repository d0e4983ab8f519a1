//! Certificates of `gleaner-server tls` with a real server and the `gleaner` command, and the errors of the command when
//! server and client do not trust each other or do not both encrypt.

use std::{path::PathBuf, time::Duration};

use rcgen::{CertificateParams, CertifiedIssuer, KeyPair, date_time_ymd};
use tempfile::TempDir;

use crate::support::{
    command,
    process::{GLEANER, Running, Signal, signal},
    secure::authority,
    server::serve,
    wait::within,
};

/// The longest time to an error, which takes milliseconds.
const AT_ONCE: Duration = Duration::from_secs(10);

/// A data folder with certificates.
struct Lab(TempDir);

impl Lab {
    async fn new() -> Self {
        let lab = Self(tempfile::tempdir().unwrap());
        lab.tls(&["init", "--name", "lab7"]).await;
        lab
    }

    async fn tls(&self, words: &[&str]) {
        let (success, text) = command::server_text(&[&["tls"], words].concat(), self.0.path()).await;
        assert!(success, "{text}");
    }

    fn file(&self, name: &str) -> String {
        self.0.path().join("tls").join(name).to_str().unwrap().to_owned()
    }

    /// Starts a server with these flags; returns it with its address without the scheme.
    async fn serve(&self, flags: &[&str]) -> (Running, String) {
        let flags = [&["--workers", "0"], flags].concat();
        let mut command = serve(self.0.path(), &flags, "127.0.0.1:0");
        command.env("GLEANER_LOG", "info");
        let server = Running::start(command.stderr(std::fs::File::create(self.log()).unwrap())).await;
        let (_, address) = server.url.split_once("://").unwrap();
        let address = address.to_owned();
        (server, address)
    }

    async fn serve_encrypted(&self, flags: &[&str]) -> (Running, String) {
        let (cert, key) = (self.file("server.pem"), self.file("server.key"));
        self.serve(&[&["--tls-cert", &cert, "--tls-key", &key], flags].concat()).await
    }

    fn log(&self) -> PathBuf {
        self.0.path().join("log")
    }
}

/// `gleaner task list` with these flags; returns its errors, which are empty on success.
async fn list(flags: &[&str]) -> String {
    let mut command = tokio::process::Command::new(GLEANER);
    let command = command::run(command.args(flags).args(["task", "list"]));
    let output = tokio::time::timeout(AT_ONCE, command).await.expect("the command does not end");
    if output.success { String::new() } else { output.errors }
}

#[tokio::test]
async fn command_line_accepts_a_renewed_server_certificate() {
    let lab = Lab::new().await;
    let (running, address) = lab.serve_encrypted(&[]).await;
    let port = address.rsplit(':').next().unwrap();
    let (ca, first) = (lab.file("ca.pem"), std::fs::read(lab.file("server.pem")).unwrap());
    for host in ["127.0.0.1", "localhost"] {
        assert_eq!(list(&["--server", &format!("https://{host}:{port}"), "--ca", &ca]).await, "");
    }

    lab.tls(&["renew"]).await;
    assert_ne!(std::fs::read(lab.file("server.pem")).unwrap(), first);
    signal(running.pid(), Signal::HUP);
    let server = format!("https://{address}");
    let reloaded = async {
        while !std::fs::read_to_string(lab.log()).unwrap().contains("the certificate was read again") {
            assert_eq!(list(&["--server", &server, "--ca", &ca]).await, "");
        }
    };
    within("the certificate is reloaded", reloaded).await;
    assert_eq!(list(&["--server", &server, "--ca", &ca]).await, "");
    let log = std::fs::read_to_string(lab.log()).unwrap();
    assert!(!log.contains("the server's certificate"), "an unexpected warning: {log}");
}

#[tokio::test]
async fn missing_client_certificate_is_named_in_the_error() {
    let lab = Lab::new().await;
    lab.tls(&["client", "arm1"]).await;
    let ca = lab.file("ca.pem");
    let (_child, address) = lab.serve_encrypted(&["--client-ca", &ca]).await;
    let server = format!("https://{address}");
    let (cert, key) = (lab.file("client-arm1.pem"), lab.file("client-arm1.key"));
    assert_eq!(list(&["--server", &server, "--ca", &ca, "--client-cert", &cert, "--client-key", &key]).await, "");
    let text = list(&["--server", &server, "--ca", &ca]).await;
    assert!(text.contains("--client-cert"), "{text}");
}

#[tokio::test]
async fn failed_handshake_ends_at_once_with_reason_and_fix() {
    let (lab, other) = (Lab::new().await, Lab::new().await);
    let (_encrypted, address) = lab.serve_encrypted(&[]).await;
    let (_plain, plain) = other.serve(&[]).await;
    let ca = lab.file("ca.pem");
    for (flags, part) in [
        (vec!["--server", "https://@", "--ca", "other"], "--ca"),
        (vec!["--server", "https://@"], "--ca"),
        (vec!["--server", "http://@"], "https://"),
        (vec!["--server", "https://plain", "--ca", "own"], "http://"),
    ] {
        let flags: Vec<String> = flags
            .into_iter()
            .map(|flag| match flag {
                "other" => other.file("ca.pem"),
                "own" => ca.clone(),
                flag => flag.replace('@', &address).replace("plain", &plain),
            })
            .collect();
        let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
        let text = list(&flags).await;
        assert!(text.starts_with("error: ") && text.contains(part), "{flags:?}: {text}");
    }
}

#[tokio::test]
async fn certificate_for_another_name_or_time_is_rejected_with_the_fix() {
    let lab = Lab::new().await;
    let authority = authority();
    std::fs::write(lab.file("other-ca.pem"), authority.pem()).unwrap();
    type Change = fn(&mut CertificateParams);
    let cases: [(&str, Change, &str, Option<&str>); 3] = [
        ("localhost", |_| (), "tls renew --name", None),
        (
            "127.0.0.1",
            |params| params.not_after = date_time_ymd(2020, 1, 1),
            "tls renew",
            Some("it expired on 2020-01-01"),
        ),
        (
            "127.0.0.1",
            |params| params.not_before = date_time_ymd(2200, 1, 1),
            "clock",
            Some("not valid before 2200-01-01"),
        ),
    ];
    for (name, change, part, warning) in cases {
        issue(&lab, &authority, name, change);
        let (_child, address) = lab.serve_encrypted(&[]).await;
        let text = list(&["--server", &format!("https://{address}"), "--ca", &lab.file("other-ca.pem")]).await;
        assert!(text.starts_with("error: ") && text.contains(part), "{text}");
        let log = std::fs::read_to_string(lab.log()).unwrap();
        assert!(warning.is_none_or(|warning| log.contains(warning)), "{log}");
    }
}

/// Replaces the server's certificate by one of another authority.
fn issue(lab: &Lab, authority: &CertifiedIssuer<'static, KeyPair>, name: &str, change: fn(&mut CertificateParams)) {
    let mut params = CertificateParams::new(vec![name.to_owned()]).unwrap();
    change(&mut params);
    let key = KeyPair::generate().unwrap();
    std::fs::write(lab.file("server.pem"), params.signed_by(&key, authority).unwrap().pem()).unwrap();
    std::fs::write(lab.file("server.key"), key.serialize_pem()).unwrap();
}
