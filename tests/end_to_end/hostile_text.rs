//! Names with terminal escapes and bidirectional controls in recordings, files and requests: every command, page and log
//! shows them escaped, and none shows them raw.

use std::path::Path;

use gleaner_recording::{
    TaskSpec,
    printable::{Escape, is_printable},
};
use serde_json::{Value, json};

use crate::support::{
    command::{self, gleaner},
    http,
    server::TestServer,
};

/// Sets the title of a terminal, clears its screen, and reverses the text that follows.
const ESCAPES: &str = "\u{1b}]0;x\u{7}\u{1b}[2J\u{202e}";
/// The characters that a topic, a schema or a cohort can have: control characters are rejected there.
const BIDI: &str = "\u{202e}\u{2066}\u{200f}";
const BIDI_SHOWN: &str = "\\u{202e}\\u{2066}\\u{200f}";

async fn start(flags: &[&str]) -> TestServer {
    let flags = [&["--workers", "0", "--web-listen", "127.0.0.1:0"], flags].concat();
    TestServer::start_logged(&flags, "debug,h2=info,hyper=info").await
}

/// Runs a command of `gleaner-server` on the data folder of a server; returns everything that it printed.
async fn server_command(server: &TestServer, words: &[&str]) -> String {
    command::server_text(words, server.data_dir()).await.1
}

/// Requests a page; returns it with its headers.
async fn page(server: &TestServer, path: &str) -> String {
    http::get(&format!("{}{path}", server.pages())).await.replace("\r\n", "\n")
}

/// Runs `gleaner`; returns everything that it printed, which is escaped.
async fn client(server: &TestServer, words: &[&str]) -> String {
    expect_escaped(&format!("gleaner {words:?}"), gleaner(server.url(), words).await.text())
}

/// Returns the text, which has no raw control character.
fn expect_escaped(what: &str, text: String) -> String {
    let raw = text.chars().find(|&character| !is_printable(character) && !matches!(character, '\n' | '\t'));
    assert_eq!(raw, None, "{what}: {}", Escape::Lines.apply(&text));
    text
}

/// A task with hostile topics.
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

/// A small recording (MCAP, not chunked) of JSON messages, whose topics, schemas and frames have hostile names. A gap causes
/// a finding in its report. With `odd`, a field that the task requires is missing.
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
async fn names_with_escapes_and_bidirectional_controls_are_shown_escaped() {
    let (server, dir) = (start(&[]).await, tempfile::tempdir().unwrap());
    write(dir.path());
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    client(&server, &["task", "create", &at("task.json")]).await;
    let cohort = format!("weak{BIDI}");

    // The command line: accepted files, rejected files, invalid arguments.
    let pushed = client(&server, &["push", &at("good"), "--outcome", "success", "--cohort", &cohort]).await;
    assert!(pushed.contains("1 recordings pushed"), "{pushed}");
    let odd = at(&format!("odd{ESCAPES}.mcap"));
    let rejected = client(&server, &["push", &odd]).await;
    assert!(rejected.contains("odd\\u{1b}]0;x\\u{7}\\u{1b}[2J\\u{202e}.mcap"), "{rejected}");
    for words in [
        &["push", &odd, "--cohort", ESCAPES][..],
        &["episode", ESCAPES],
        &["--json", "episode", ESCAPES],
        &["push", "--jobs", ESCAPES],
        &["push", &at(ESCAPES)],
        &["task", "show", ESCAPES],
    ] {
        let text = client(&server, words).await;
        assert!(text.contains("\\u{202e}"), "{words:?}: {text}");
    }
    let listed = client(&server, &["episodes"]).await;
    assert!(listed.contains(&format!("weak{BIDI_SHOWN}")) && listed.contains("a\\u{1b}]0;x"), "{listed}");
    let episodes: Value = serde_json::from_str(&client(&server, &["--json", "episodes"]).await).unwrap();
    assert_eq!(episodes["episodes"][0]["cohort"], cohort, "JSON parses to the original text");
    let id = episodes["episodes"][0]["id"].as_str().unwrap();
    client(&server, &["label", id, "--outcome", "failure", "--reason", BIDI]).await;
    for words in [&["episode", id][..], &["--json", "episode", id], &["labels", id], &["--json", "task", "show", "arm"]]
    {
        assert!(client(&server, words).await.contains("202e"), "{words:?}");
    }

    // The pages, also those of unknown objects.
    for path in ["/", "/tasks/arm/episodes", &format!("/episodes/{id}"), "/jobs"] {
        let page = expect_escaped(path, page(&server, path).await);
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
        expect_escaped(&path, page(&server, &path).await);
    }
    let data = expect_escaped("JSON", page(&server, "/tasks/arm/episodes?format=json").await);
    assert!(data.contains("weak\\u202e"), "{data}");

    // The commands of the server. `check` names a stray file among the blobs.
    std::fs::write(server.data_dir().join("blobs").join(ESCAPES), b"x").unwrap();
    expect_escaped(
        "token create",
        server_command(&server, &["token", "create", "--role", "robot", "--name", &cohort, "--deployment", "arm"])
            .await,
    );
    for (words, part) in [
        (&["token", "list"][..], BIDI_SHOWN),
        (&["audit", "--since", "1h"], "202e"),
        (&["check"], "\\u{1b}[2J\\u{202e}"),
        (&["check", "--json"], "\\u001b[2J\\u202e"),
    ] {
        let text = expect_escaped(&format!("{words:?}"), server_command(&server, words).await);
        assert!(text.contains(part), "{words:?}: {text}");
    }

    let log = expect_escaped("the log", server.log());
    assert!(log.contains("202e"), "no hostile name was logged: {log}");
}

#[tokio::test]
async fn log_of_json_lines_is_escaped_and_parses() {
    let server = start(&["--log-json"]).await;
    client(&server, &["episode", ESCAPES]).await;
    client(&server, &["task", "show", ESCAPES]).await;
    let log = expect_escaped("the log", server.log());
    let lines: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(
        lines.iter().any(|line| line.to_string().contains("202e") || line.to_string().contains('\u{202e}')),
        "{log}"
    );
}
