//! What a lab has recorded is kept: checked, backed up beside a running server, deleted in two steps, and safe when the
//! disk is full.

use std::{path::Path, time::Duration};

use gleaner_proto::v1::*;
use tokio::process::Command;
use tonic::Code;

use crate::{
    api::Api,
    lab::{self, RECORDINGS},
    server::TestServer,
};

/// Runs a command of the server's program; gives back whether it said that all is well, and what it said.
pub async fn command(words: &[&str], data_dir: &Path) -> (bool, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_gleaner-server-under-test"))
        .args(words)
        .arg("--data-dir")
        .arg(data_dir)
        .env("GLEANER_LOG", "warn")
        .kill_on_drop(true)
        .output()
        .await
        .unwrap();
    let said = String::from_utf8(output.stdout).unwrap() + &String::from_utf8(output.stderr).unwrap();
    (output.status.success(), said)
}

/// Two experts and a failure; what each test here needs.
async fn a_few(api: &mut Api) -> Vec<Episode> {
    lab::create_task(api).await;
    let mut episodes = Vec::new();
    for recording in [&RECORDINGS[0], &RECORDINGS[1], &RECORDINGS[6]] {
        episodes.push(lab::push(api, lab::TASK, recording).await.unwrap());
    }
    episodes
}

async fn listed(api: &mut Api, deleted: bool) -> Vec<Episode> {
    let request = ListEpisodesRequest { task: lab::TASK.into(), deleted, ..Default::default() };
    api.episodes.list_episodes(request).await.unwrap().into_inner().episodes
}

#[tokio::test]
async fn a_lab_is_backed_up_while_it_runs_and_goes_on_from_the_copy() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    let episodes = a_few(&mut api).await;
    let places = tempfile::tempdir().unwrap();
    let (backup, new) = (places.path().join("backup"), places.path().join("new"));
    let target = backup.to_str().unwrap();

    let (sound, said) = command(&["check"], server.data_dir()).await;
    assert!(sound, "{said}");
    let (sound, said) = command(&["backup", target], server.data_dir()).await;
    assert!(sound && said.contains(&format!("{} of them new", episodes.len())), "{said}");
    let (sound, said) = command(&["backup", target], server.data_dir()).await;
    assert!(sound && said.contains(" 0 of them new"), "{said}");
    let (sound, said) = command(&["restore", target], server.data_dir()).await;
    assert!(!sound && said.contains("not empty"), "{said}");
    let (sound, said) = command(&["restore", target], &new).await;
    assert!(sound, "{said}");

    let restored = TestServer::start_over(&new, &["--workers", "0"]).await;
    let mut other = Api::connect(&restored).await;
    assert_eq!(listed(&mut other, false).await, listed(&mut api, false).await);
    let request = DownloadEpisodeRequest { episode_id: episodes[0].id.clone() };
    let mut chunks = other.episodes.download_episode(request).await.unwrap().into_inner();
    let mut bytes = Vec::new();
    while let Some(chunk) = chunks.message().await.unwrap() {
        bytes.extend_from_slice(&chunk.data);
    }
    assert!(bytes == RECORDINGS[0].bytes);

    // Bit rot is found, and named with the episode that has it.
    let rotten = blob(&new, &episodes[0].blake3);
    let mut content = std::fs::read(&rotten).unwrap();
    content[100] ^= 1;
    std::fs::write(&rotten, content).unwrap();
    assert!(command(&["check", "--fast"], &new).await.0);
    let (sound, said) = command(&["check"], &new).await;
    assert!(!sound && said.contains(&episodes[0].blake3) && said.contains(&episodes[0].id), "{said}");
}

fn blob(data_dir: &Path, blake3: &str) -> std::path::PathBuf {
    data_dir.join("blobs").join(&blake3[..2]).join(&blake3[2..])
}

#[tokio::test]
async fn an_episode_goes_in_two_steps() {
    let mut server = TestServer::start_with(&["--workers", "0", "--trash-days", "0"]).await;
    let mut api = Api::connect(&server).await;
    let episodes = a_few(&mut api).await;
    let (first, second) = (&episodes[0], &episodes[1]);
    let delete = |id: &str, force| DeleteEpisodesRequest { episode_ids: vec![id.into()], force };
    let undelete = |id: &str| UndeleteEpisodesRequest { episode_ids: vec![id.into()] };

    api.episodes.delete_episodes(delete(&first.id, false)).await.unwrap();
    api.episodes.delete_episodes(delete(&second.id, false)).await.unwrap();
    assert_eq!(listed(&mut api, false).await, episodes[2..]);
    assert_eq!(listed(&mut api, true).await.len(), 2);
    let again = lab::start(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap_err();
    assert!(again.code() == Code::AlreadyExists && again.message().contains("gleaner restore"), "{again}");
    api.episodes.undelete_episodes(undelete(&second.id)).await.unwrap();
    assert_eq!(listed(&mut api, false).await, episodes[1..]);

    let snapshot = CreateSnapshotRequest { task: lab::TASK.into(), ..Default::default() };
    let snapshot = api.snapshots.create_snapshot(snapshot).await.unwrap().into_inner().snapshot.unwrap();
    let held = api.episodes.delete_episodes(delete(&second.id, false)).await.unwrap_err();
    assert!(held.code() == Code::FailedPrecondition && held.message().contains(&snapshot.id), "{held}");
    for (ids, code) in [(vec![], Code::InvalidArgument), (vec!["ep_1".to_owned()], Code::InvalidArgument)] {
        let request = DeleteEpisodesRequest { episode_ids: ids.clone(), force: true };
        assert_eq!(api.episodes.delete_episodes(request).await.unwrap_err().code(), code);
        let request = UndeleteEpisodesRequest { episode_ids: ids };
        assert_eq!(api.episodes.undelete_episodes(request).await.unwrap_err().code(), code);
    }

    // A server sweeps when it starts; stopping waits for the sweep that it has begun.
    assert!(server.stop().await);
    server.start_again().await;
    let mut api = Api::connect(&server).await;
    let gone = GetEpisodeRequest { episode_id: first.id.clone() };
    let swept = async {
        while api.episodes.get_episode(gone.clone()).await.is_ok() {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), swept).await.expect("the sweep takes too long");
    assert_eq!(api.episodes.undelete_episodes(undelete(&first.id)).await.unwrap_err().code(), Code::NotFound);
    let (sound, said) = command(&["check"], server.data_dir()).await;
    assert!(sound, "{said}");
    lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    assert_eq!(listed(&mut api, false).await.len(), episodes.len(), "it can be pushed again");
}

/// A mark that no disk comes up to: what is large is refused, all else goes on.
#[tokio::test]
async fn a_disk_that_is_nearly_full_takes_nothing_large() {
    let mut server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let episodes = vec![lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap()];
    assert!(server.stop().await);
    let mark = u64::MAX.to_string();
    let full = TestServer::start_over(server.data_dir(), &["--workers", "0", "--min-free-bytes", &mark]).await;
    let mut api = Api::connect(&full).await;
    let refused = |status: tonic::Status| {
        assert_eq!(status.code(), Code::ResourceExhausted, "{status}");
        assert!(status.message().contains("nearly full"), "{status}");
    };
    refused(lab::start(&mut api, lab::TASK, &RECORDINGS[7]).await.unwrap_err());
    refused(api.submit(lab::TASK, lab::pretrain(4)).await.unwrap_err());
    assert_eq!(listed(&mut api, false).await, episodes);
    let label = LabelEpisodesRequest {
        episode_ids: vec![episodes[0].id.clone()],
        outcome: Outcome::Unknown.into(),
        ..Default::default()
    };
    api.episodes.label_episodes(label).await.unwrap();
}
