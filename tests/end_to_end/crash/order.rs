//! Power loss: what is acknowledged was synced before, file, folder and row in this order. Seen from outside, by the
//! system calls that the server makes.

use std::{
    collections::HashMap,
    path::Path,
    process::Stdio,
    time::{SystemTime, UNIX_EPOCH},
};

use gleaner_proto::v1::*;
use rustix::process::{Pid, Signal, kill_process};
use tokio::{
    io::{AsyncBufReadExt as _, BufReader},
    process::{Child, Command},
};

use crate::{api::Api, lab, server::TestServer, skipped::skipped};

/// A system call that has ended, with the paths of its files.
#[derive(Clone, Debug)]
struct Call {
    ended: f64,
    text: String,
}

/// Whoever watches the server's system calls. `None` where that is not to be had.
async fn watch(server: &TestServer, out: &Path) -> Option<Child> {
    let mut child = Command::new("strace")
        .args(["-f", "-y", "-T", "-ttt", "-e", "trace=fsync,fdatasync,rename,renameat,renameat2,linkat", "-o"])
        .arg(out)
        .args(["-p", &server.pid().to_string()])
        .stderr(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .ok()?;
    let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
    let line = said.next_line().await.unwrap().unwrap_or_default();
    if !line.contains("attached") {
        eprintln!("{line}");
        return None;
    }
    // Read on, so that it never waits for a reader.
    tokio::spawn(async move { while let Ok(Some(_)) = said.next_line().await {} });
    Some(child)
}

fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// Reads lines such as `7 1700000000.5 fsync(3</a/b>) = 0 <0.01>`, and those that another thread's line cuts in two.
fn calls(text: &str) -> Vec<Call> {
    let mut begun: HashMap<&str, &str> = HashMap::new();
    let mut calls = Vec::new();
    for line in text.lines() {
        // Threads' numbers are padded.
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

/// The calls between two moments in which each of these comes after the one before: a call's name and a part of what it
/// is about.
fn in_order(calls: &[Call], between: (f64, f64), wanted: &[(&str, &str)]) {
    let within: Vec<&Call> = calls.iter().filter(|call| between.0 <= call.ended && call.ended <= between.1).collect();
    let mut rest = within.iter();
    for (name, about) in wanted {
        let found = rest.any(|call| call.text.starts_with(name) && call.text.contains(about));
        assert!(found, "no {name} of {about}, in the order of {wanted:?}, before the answer: {within:#?}");
    }
}

/// The row is on disk: the end of every order.
const ROW: (&str, &str) = ("f", "gleaner.db-wal>");

#[tokio::test]
async fn what_is_acknowledged_was_synced_before_in_the_right_order() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let out = tempfile::NamedTempFile::new().unwrap();
    let Some(mut watching) = watch(&server, out.path()).await else {
        return skipped("the order of syncs is not looked at, because strace cannot watch the server here");
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
    let label = LabelEpisodesRequest {
        episode_ids: vec![episode.id],
        outcome: Outcome::Failure.into(),
        ..LabelEpisodesRequest::default()
    };
    api.episodes.label_episodes(label).await.unwrap();
    let labelled = now();
    let other = &lab::RECORDINGS[1];
    lab::push(&mut api, lab::TASK, other).await.unwrap();
    let pushed = now();
    api.submit(lab::TASK, lab::pretrain(3)).await.unwrap();
    let submitted = now();

    let pid = Pid::from_raw(i32::try_from(watching.id().unwrap()).unwrap()).unwrap();
    kill_process(pid, Signal::INT).unwrap();
    watching.wait().await.unwrap();
    let calls = calls(&std::fs::read_to_string(out.path()).unwrap());
    let part = format!("uploads/{upload}.part");
    let (folder, name) = blake3.split_at(2);
    let (blob, folder) = (format!("blobs/{folder}/{name}"), format!("blobs/{folder}>"));
    in_order(&calls, (begun, started), &[("fsync", "/uploads>"), ROW]);
    in_order(&calls, (started, written), &[("fdatasync", part.as_str()), ROW]);
    let placed = [("fsync", part.as_str()), ("rename", &blob), ("fsync", &folder), ("fsync", "/blobs>"), ROW];
    in_order(&calls, (written, finished), &placed);
    in_order(&calls, (finished, labelled), &[ROW]);
    in_order(&calls, (pushed, submitted), &[ROW]);
}
