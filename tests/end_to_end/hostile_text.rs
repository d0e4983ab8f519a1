//! Names from recordings, files and callers that carry terminal escapes and bidirectional controls: no command, page or
//! log shows them raw, and all show them escaped.

use std::{path::Path, process::Stdio};

use gleaner_recording::{
    TaskSpec,
    printable::{Escape, is_printable},
};
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
    process::{Child, Command},
};

use crate::{command::gleaner, server::listening};

const SERVER: &str = env!("CARGO_BIN_EXE_gleaner-server-under-test");
/// Sets a terminal's title, clears its screen, and turns what follows around.
const ESCAPES: &str = "\u{1b}]0;x\u{7}\u{1b}[2J\u{202e}";
/// The part of it that a topic, a schema or a cohort can have: control characters are refused there.
const BIDI: &str = "\u{202e}\u{2066}\u{200f}";
const BIDI_SHOWN: &str = "\\u{202e}\\u{2066}\\u{200f}";

/// A server whose log goes to a file.
struct Server {
    folder: TempDir,
    url: String,
    pages: String,
    _child: Child,
}

impl Server {
    async fn start(flags: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let log = std::fs::File::create(folder.path().join("log")).unwrap();
        let mut child = Command::new(SERVER)
            .args(["serve", "--listen", "127.0.0.1:0", "--web-listen", "127.0.0.1:0", "--workers", "0", "--data-dir"])
            .arg(folder.path().join("data"))
            .args(flags)
            .env("GLEANER_LOG", "debug,h2=info,hyper=info")
            .stdout(Stdio::piped())
            .stderr(log)
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        let (url, pages) = listening(&mut child).await.expect("the server ended before it listened");
        Self { folder, url, pages: pages.unwrap(), _child: child }
    }

    fn log(&self) -> String {
        String::from_utf8(std::fs::read(self.folder.path().join("log")).unwrap()).unwrap()
    }

    /// `gleaner-server` beside it: all it printed.
    async fn command(&self, words: &[&str]) -> String {
        let data = self.folder.path().join("data");
        let output = Command::new(SERVER).args(words).arg("--data-dir").arg(data).output().await.unwrap();
        String::from_utf8([output.stdout, output.stderr].concat()).unwrap()
    }

    /// A page, with its headers.
    async fn page(&self, path: &str) -> String {
        let address = self.pages.strip_prefix("http://").unwrap();
        let mut stream = TcpStream::connect(address).await.unwrap();
        let head = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nAccept: text/html\r\nConnection: close\r\n\r\n");
        stream.write_all(head.as_bytes()).await.unwrap();
        let mut page = Vec::new();
        stream.read_to_end(&mut page).await.unwrap();
        String::from_utf8(page).unwrap().replace("\r\n", "\n")
    }
}

/// Runs `gleaner`; all it printed.
async fn told(server: &Server, words: &[&str]) -> String {
    let (_, out, errors) = gleaner(&server.url, words).await;
    clean(&format!("gleaner {words:?}"), out + &errors)
}

/// The text, in which nothing is raw.
fn clean(what: &str, text: String) -> String {
    let raw = text.chars().find(|&character| !is_printable(character) && !matches!(character, '\n' | '\t'));
    assert_eq!(raw, None, "{what}: {}", Escape::Lines.apply(&text));
    text
}

/// A task whose topics, and what its mapping is called, are hostile.
fn task() -> TaskSpec {
    let field = |name: &str, topic: String| json!({ "field": name, "topic": topic, "paths": ["values"] });
    let spec = json!({
        "name": "arm", "rate_hz": 10.0,
        "proprioception": [{ "name": "joints", "size": 2 }],
        "action": [{ "name": "command", "size": 2 }],
        "mappings": [{
            "name": "json",
            "fields": [field("joints", format!("/joints{BIDI}")), field("command", format!("/command{BIDI}"))],
        }],
    });
    serde_json::from_value(spec).unwrap()
}

/// A small recording (MCAP, not chunked) of JSON messages, whose topics, schemas and frames have hostile names. With a
/// gap, so that its report has a finding; with `odd`, a field that the task looks for is not there.
fn recording(odd: bool) -> Vec<u8> {
    let text = |text: &str| [&u32::try_from(text.len()).unwrap().to_le_bytes()[..], text.as_bytes()].concat();
    let record = |kind: u8, content: &[u8]| {
        [&[kind][..], &u64::try_from(content.len()).unwrap().to_le_bytes(), content].concat()
    };
    let magic = b"\x89MCAP0\r\n".to_vec();
    let mut file = [magic.clone(), record(1, &[text(""), text("")].concat())].concat();
    for (id, topic) in [(1_u16, "/joints"), (2, "/command"), (3, "/other")] {
        let id = id.to_le_bytes().to_vec();
        let schema = [id.clone(), text(&format!("Schema{BIDI}")), text("jsonschema"), text("{}")].concat();
        let topic = text(&format!("{topic}{BIDI}"));
        let channel = [id.clone(), id, topic, text("json"), 0_u32.to_le_bytes().to_vec()].concat();
        file.extend(record(3, &schema));
        file.extend(record(4, &channel));
    }
    for step in (0..12_u64).chain(30..42) {
        let (nanos, value) = (1_000_000_000 + step * 100_000_000, f64::from(u32::try_from(step).unwrap()) / 10.0);
        for id in 1..=3_u16 {
            let values = if odd && id == 2 { "missing" } else { "values" };
            let message = json!({
                "timestamp": { "sec": nanos / 1_000_000_000, "nsec": nanos % 1_000_000_000 },
                "frame_id": ESCAPES, values: [value, -value], ESCAPES: 1,
            });
            let head = [&id.to_le_bytes()[..], &[0; 4], &nanos.to_le_bytes(), &nanos.to_le_bytes()].concat();
            file.extend(record(5, &[head, message.to_string().into_bytes()].concat()));
        }
    }
    file.extend(record(15, &[0; 4]));
    file.extend(record(2, &[0; 20]));
    file.extend(magic);
    file
}

fn write(dir: &Path) {
    std::fs::write(dir.join("task.json"), serde_json::to_vec(&task()).unwrap()).unwrap();
    std::fs::create_dir(dir.join("good")).unwrap();
    std::fs::write(dir.join("good").join(format!("a{ESCAPES}.mcap")), recording(false)).unwrap();
    std::fs::write(dir.join(format!("odd{ESCAPES}.mcap")), recording(true)).unwrap();
}

#[tokio::test]
async fn names_with_escapes_and_bidirectional_controls_are_shown_escaped_everywhere() {
    let (server, dir) = (Server::start(&[]).await, tempfile::tempdir().unwrap());
    write(dir.path());
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    told(&server, &["task", "create", &at("task.json")]).await;
    let cohort = format!("weak{BIDI}");

    // The command line: what is taken, what is not, and what is wrong.
    let pushed = told(&server, &["push", &at("good"), "--outcome", "success", "--cohort", &cohort]).await;
    assert!(pushed.contains("1 recordings pushed"), "{pushed}");
    let odd = at(&format!("odd{ESCAPES}.mcap"));
    let refused = told(&server, &["push", &odd]).await;
    assert!(refused.contains("odd\\u{1b}]0;x\\u{7}\\u{1b}[2J\\u{202e}.mcap"), "{refused}");
    for words in [
        &["push", &odd, "--cohort", ESCAPES][..],
        &["episode", ESCAPES],
        &["--json", "episode", ESCAPES],
        &["push", "--jobs", ESCAPES],
        &["push", &at(ESCAPES)],
        &["task", "show", ESCAPES],
    ] {
        let said = told(&server, words).await;
        assert!(said.contains("\\u{202e}"), "{words:?}: {said}");
    }
    let listed = told(&server, &["episodes"]).await;
    assert!(listed.contains(&format!("weak{BIDI_SHOWN}")) && listed.contains("a\\u{1b}]0;x"), "{listed}");
    let episodes: Value = serde_json::from_str(&told(&server, &["--json", "episodes"]).await).unwrap();
    assert_eq!(episodes["episodes"][0]["cohort"], cohort, "JSON reads back as it was");
    let id = episodes["episodes"][0]["id"].as_str().unwrap();
    told(&server, &["label", id, "--outcome", "failure", "--reason", BIDI]).await;
    for words in [&["episode", id][..], &["--json", "episode", id], &["labels", id], &["--json", "task", "show", "arm"]]
    {
        assert!(told(&server, words).await.contains("202e"), "{words:?}");
    }

    // The pages, also those of what is not there.
    for path in ["/", "/tasks/arm/episodes", &format!("/episodes/{id}"), "/jobs"] {
        let page = clean(path, server.page(path).await);
        assert!(page.starts_with("HTTP/1.1 200"), "{page}");
        assert!(!path.contains("episodes") || page.contains(BIDI_SHOWN), "{page}");
    }
    let encoded = "%1B%5B2J%E2%80%AE";
    for path in [
        format!("/tasks/arm/episodes?text={encoded}&cohort={encoded}"),
        format!("/tasks/{encoded}/episodes"),
        format!("/episodes/{encoded}"),
        format!("/assets/{encoded}"),
        "/tasks/arm/episodes?format=csv".to_owned(),
        format!("/episodes/{id}?format=csv"),
    ] {
        clean(&path, server.page(&path).await);
    }
    let data = clean("JSON", server.page("/tasks/arm/episodes?format=json").await);
    assert!(data.contains("weak\\u202e"), "{data}");

    // The server's own commands. What lies about among the blobs is named by `check`.
    std::fs::write(server.folder.path().join("data/blobs").join(ESCAPES), b"x").unwrap();
    clean(
        "token create",
        server.command(&["token", "create", "--role", "robot", "--name", &cohort, "--deployment", "arm"]).await,
    );
    for (words, part) in [
        (&["token", "list"][..], BIDI_SHOWN),
        (&["audit", "--since", "1h"], "202e"),
        (&["check"], "\\u{1b}[2J\\u{202e}"),
        (&["check", "--json"], "\\u001b[2J\\u202e"),
    ] {
        let said = clean(&format!("{words:?}"), server.command(words).await);
        assert!(said.contains(part), "{words:?}: {said}");
    }

    let log = clean("the log", server.log());
    assert!(log.contains("202e"), "nothing hostile was logged: {log}");
}

#[tokio::test]
async fn a_log_of_json_lines_is_clean_and_reads_back() {
    let server = Server::start(&["--log-json"]).await;
    told(&server, &["episode", ESCAPES]).await;
    told(&server, &["task", "show", ESCAPES]).await;
    let log = clean("the log", server.log());
    let lines: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(
        lines.iter().any(|line| line.to_string().contains("202e") || line.to_string().contains('\u{202e}')),
        "{log}"
    );
}
