//! Certificates of `gleaner-server tls`, with a real server and the `gleaner` command; and what the command says when
//! server and client do not trust each other or do not both encrypt.

use std::{path::PathBuf, process::Stdio, time::Duration};

use rcgen::{CertificateParams, CertifiedIssuer, KeyPair, date_time_ymd};
use tempfile::TempDir;
use tokio::process::{Child, Command};

use super::{PATIENCE, guarded::authority};
use crate::server::listening;

const SERVER: &str = env!("CARGO_BIN_EXE_gleaner-server-under-test");
const GLEANER: &str = env!("CARGO_BIN_EXE_gleaner-under-test");
/// A refusal comes within this time; it takes milliseconds.
const AT_ONCE: Duration = Duration::from_secs(10);

/// A folder with certificates, and servers over it.
struct Lab(TempDir);

impl Lab {
    async fn new() -> Self {
        let lab = Self(tempfile::tempdir().unwrap());
        lab.tls(&["init", "--name", "lab7"]).await;
        lab
    }

    async fn tls(&self, words: &[&str]) -> String {
        let output =
            Command::new(SERVER).arg("tls").args(words).arg("--data-dir").arg(self.0.path()).output().await.unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    fn file(&self, name: &str) -> String {
        self.0.path().join("tls").join(name).to_str().unwrap().to_owned()
    }

    /// Starts a server with these flags; its address without the scheme.
    async fn serve(&self, flags: &[&str]) -> (Child, String) {
        let mut child = Command::new(SERVER)
            .args(["serve", "--listen", "127.0.0.1:0", "--workers", "0", "--data-dir"])
            .arg(self.0.path())
            .args(flags)
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(self.log()).unwrap())
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        let (url, _) = listening(&mut child).await.expect("the server ended before it listened");
        let (_, address) = url.split_once("://").unwrap();
        (child, address.to_owned())
    }

    async fn serve_encrypted(&self, flags: &[&str]) -> (Child, String) {
        let (cert, key) = (self.file("server.pem"), self.file("server.key"));
        self.serve(&[&["--tls-cert", &cert, "--tls-key", &key], flags].concat()).await
    }

    fn log(&self) -> PathBuf {
        self.0.path().join("log")
    }
}

/// `gleaner task list` with these flags; its errors, empty when it went well.
async fn list(flags: &[&str]) -> String {
    let command =
        Command::new(GLEANER).args(flags).args(["task", "list"]).stdin(Stdio::null()).kill_on_drop(true).output();
    let output = tokio::time::timeout(AT_ONCE, command).await.expect("the command does not end").unwrap();
    if output.status.success() { String::new() } else { String::from_utf8(output.stderr).unwrap() }
}

#[tokio::test]
async fn the_command_line_accepts_the_servers_certificate_also_once_it_is_renewed() {
    let lab = Lab::new().await;
    let (child, address) = lab.serve_encrypted(&[]).await;
    let port = address.rsplit(':').next().unwrap();
    let (ca, first) = (lab.file("ca.pem"), std::fs::read(lab.file("server.pem")).unwrap());
    for host in ["127.0.0.1", "localhost"] {
        assert_eq!(list(&["--server", &format!("https://{host}:{port}"), "--ca", &ca]).await, "");
    }

    lab.tls(&["renew"]).await;
    assert_ne!(std::fs::read(lab.file("server.pem")).unwrap(), first);
    let pid = rustix::process::Pid::from_raw(child.id().unwrap().try_into().unwrap()).unwrap();
    rustix::process::kill_process(pid, rustix::process::Signal::HUP).unwrap();
    let server = format!("https://{address}");
    let read_again = async {
        while !std::fs::read_to_string(lab.log()).unwrap().contains("the certificate was read again") {
            assert_eq!(list(&["--server", &server, "--ca", &ca]).await, "");
        }
    };
    tokio::time::timeout(PATIENCE, read_again).await.unwrap();
    assert_eq!(list(&["--server", &server, "--ca", &ca]).await, "");
    let log = std::fs::read_to_string(lab.log()).unwrap();
    assert!(!log.contains("the server's certificate"), "nothing is wrong with it: {log}");
}

#[tokio::test]
async fn a_client_certificate_lets_the_command_line_in_and_its_lack_is_said() {
    let lab = Lab::new().await;
    lab.tls(&["client", "arm1"]).await;
    let ca = lab.file("ca.pem");
    let (_child, address) = lab.serve_encrypted(&["--client-ca", &ca]).await;
    let server = format!("https://{address}");
    let (cert, key) = (lab.file("client-arm1.pem"), lab.file("client-arm1.key"));
    assert_eq!(list(&["--server", &server, "--ca", &ca, "--client-cert", &cert, "--client-key", &key]).await, "");
    let said = list(&["--server", &server, "--ca", &ca]).await;
    assert!(said.contains("--client-cert"), "{said}");
}

#[tokio::test]
async fn a_handshake_that_fails_ends_at_once_with_its_reason_and_the_fix() {
    let (lab, stranger) = (Lab::new().await, Lab::new().await);
    let (_encrypted, address) = lab.serve_encrypted(&[]).await;
    let (_plain, plain) = stranger.serve(&[]).await;
    let ca = lab.file("ca.pem");
    for (flags, part) in [
        (vec!["--server", "https://@", "--ca", "stranger"], "--ca"),
        (vec!["--server", "https://@"], "--ca"),
        (vec!["--server", "http://@"], "https://"),
        (vec!["--server", "https://plain", "--ca", "own"], "http://"),
    ] {
        let flags: Vec<String> = flags
            .into_iter()
            .map(|flag| match flag {
                "stranger" => stranger.file("ca.pem"),
                "own" => ca.clone(),
                flag => flag.replace('@', &address).replace("plain", &plain),
            })
            .collect();
        let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
        let said = list(&flags).await;
        assert!(said.starts_with("error: ") && said.contains(part), "{flags:?}: {said}");
    }
}

#[tokio::test]
async fn certificates_for_other_names_or_times_are_refused_with_the_fix_and_the_server_warns_of_them() {
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
        let said = list(&["--server", &format!("https://{address}"), "--ca", &lab.file("other-ca.pem")]).await;
        assert!(said.starts_with("error: ") && said.contains(part), "{said}");
        let log = std::fs::read_to_string(lab.log()).unwrap();
        assert!(warning.is_none_or(|warning| log.contains(warning)), "{log}");
    }
}

/// Puts a certificate of another authority in place of the server's.
fn issue(lab: &Lab, authority: &CertifiedIssuer<'static, KeyPair>, name: &str, change: fn(&mut CertificateParams)) {
    let mut params = CertificateParams::new(vec![name.to_owned()]).unwrap();
    change(&mut params);
    let key = KeyPair::generate().unwrap();
    std::fs::write(lab.file("server.pem"), params.signed_by(&key, authority).unwrap().pem()).unwrap();
    std::fs::write(lab.file("server.key"), key.serialize_pem()).unwrap();
}
