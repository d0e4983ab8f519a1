//! Power loss: file, folder and row are synced in this order before a change is acknowledged, as the system calls of the
//! server show.

use std::{
    collections::HashMap,
    path::Path,
    process::Stdio,
    time::{SystemTime, UNIX_EPOCH},
};

use gleaner_proto::v1::*;
use tokio::{
    io::{AsyncBufReadExt as _, BufReader},
    process::{Child, Command},
};

use crate::support::{
    lab,
    process::{Signal, signal},
    server::TestServer,
    skipped::skipped,
};

/// A completed system call with the paths of its files.
#[derive(Clone, Debug)]
struct Call {
    ended: f64,
    text: String,
}

/// Traces the server's system calls into a file. `None` where that is not possible.
async fn watch(server: &TestServer, out: &Path) -> Option<Child> {
    let mut child = Command::new("strace")
        .args(["-f", "-y", "-T", "-ttt", "-e", "trace=fsync,fdatasync,rename,renameat,renameat2,linkat", "-o"])
        .arg(out)
        .args(["-p", &server.pid().to_string()])
        .stderr(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .ok()?;
    let mut errors = BufReader::new(child.stderr.take().unwrap()).lines();
    let line = errors.next_line().await.unwrap().unwrap_or_default();
    if !line.contains("attached") {
        eprintln!("{line}");
        return None;
    }
    // strace blocks if its errors are not read.
    tokio::spawn(async move { while let Ok(Some(_)) = errors.next_line().await {} });
    Some(child)
}

fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// Parses lines such as `7 1700000000.5 fsync(3</a/b>) = 0 <0.01>`, also those that the line of another thread splits.
fn calls(text: &str) -> Vec<Call> {
    let mut begun: HashMap<&str, &str> = HashMap::new();
    let mut calls = Vec::new();
    for line in text.lines() {
        // The numbers of threads are padded.
        let Some((thread, rest)) = line.split_once(' ') else { continue };
        let Some((at, rest)) = rest.trim_start().split_once(' ') else { continue };
        let Ok(at) = at.parse::<f64>() else { continue };
        if let Some(start) = rest.strip_suffix("<unfinished ...>") {
            begun.insert(thread, start);
        } else if rest.starts_with("<...") {
            let Some(start) = begun.remove(thread) else { continue };
            calls.push(Call { ended: at, text: format!("{start}{rest}") });
        } else {
            let took = rest.rsplit_once('<').and_then(|(_, took)| took.trim_end_matches('>').parse::<f64>().ok());
            calls.push(Call { ended: at + took.unwrap_or(0.0), text: rest.to_owned() });
        }
    }
    calls.retain(|call| call.text.contains("= 0"));
    calls.sort_by(|a, b| a.ended.total_cmp(&b.ended));
    calls
}

/// Checks that calls between two moments include these in this order, each by its name and a part of its text.
fn expect_order(calls: &[Call], between: (f64, f64), wanted: &[(&str, &str)]) {
    let within: Vec<&Call> = calls.iter().filter(|call| between.0 <= call.ended && call.ended <= between.1).collect();
    let mut rest = within.iter();
    for (name, about) in wanted {
        let found = rest.any(|call| call.text.starts_with(name) && call.text.contains(about));
        assert!(found, "no {name} of {about}, in the order of {wanted:?}, before the response: {within:#?}");
    }
}

/// The sync of the row, which ends every order.
const ROW: (&str, &str) = ("f", "gleaner.db-wal>");

#[tokio::test]
async fn changes_are_synced_in_order_before_they_are_acknowledged() {
    if gleaner_test_postgres::selected() {
        skipped("the files of SQLite are watched");
        return;
    }
    let (server, mut api) = lab::idle().await;
    let out = tempfile::NamedTempFile::new().unwrap();
    let Some(mut watching) = watch(&server, out.path()).await else {
        return skipped("the order of syncs is not checked, because strace cannot trace the server here");
    };
    let recording = &lab::RECORDINGS[0];
    let blake3 = blake3::hash(&recording.bytes).to_hex().to_string();
    let begun = now();
    let upload = lab::start(&mut api, lab::TASK, recording).await.unwrap().upload_id;
    let started = now();
    lab::write(&mut api, &upload, 0, recording.bytes.clone()).await.unwrap();
    let written = now();
    let episode = lab::finish(&mut api, &upload).await.unwrap();
    let finished = now();
    api.label(&episode.id, Outcome::Failure).await.unwrap();
    let labelled = now();
    let other = &lab::RECORDINGS[1];
    lab::push(&mut api, lab::TASK, other).await.unwrap();
    let pushed = now();
    api.submit(lab::TASK, lab::pretrain(3)).await.unwrap();
    let submitted = now();

    signal(watching.id().unwrap(), Signal::INT);
    watching.wait().await.unwrap();
    let calls = calls(&std::fs::read_to_string(out.path()).unwrap());
    let part = format!("uploads/{upload}.part");
    let (folder, name) = blake3.split_at(2);
    let (blob, folder) = (format!("blobs/{folder}/{name}"), format!("blobs/{folder}>"));
    expect_order(&calls, (begun, started), &[("fsync", "/uploads>"), ROW]);
    expect_order(&calls, (started, written), &[("fdatasync", part.as_str()), ROW]);
    let placed = [("fsync", part.as_str()), ("rename", &blob), ("fsync", &folder), ("fsync", "/blobs>"), ROW];
    expect_order(&calls, (written, finished), &placed);
    expect_order(&calls, (finished, labelled), &[ROW]);
    expect_order(&calls, (pushed, submitted), &[ROW]);
}
