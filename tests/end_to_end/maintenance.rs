//! Maintenance: checks, backups of a running server, deletion in two steps, and a disk that is nearly full.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    command::{expect_sound, server_text},
    errors::expect_error,
    files,
    lab::{self, RECORDINGS},
    server::TestServer,
    wait::until,
};

/// Pushes two experts and a failure.
async fn push_some(api: &mut Api) -> Vec<Episode> {
    lab::create_task(api).await;
    let mut episodes = Vec::new();
    for recording in [&RECORDINGS[0], &RECORDINGS[1], &RECORDINGS[6]] {
        episodes.push(lab::push(api, lab::TASK, recording).await.unwrap());
    }
    episodes
}

/// Imports scores of a new snapshot.
async fn import_scores(api: &mut Api) {
    let request = CreateSnapshotRequest { task: lab::TASK.into(), rule: None };
    let snapshot = api.snapshots.create_snapshot(request).await.unwrap().into_inner().snapshot.unwrap().id;
    let messages = lab::import(api, &snapshot, "an oracle").await;
    api.scores.import_scores(tokio_stream::iter(messages)).await.unwrap();
}

async fn score_runs(api: &mut Api) -> Vec<ScoreRun> {
    let request = ListScoreRunsRequest { task: lab::TASK.into(), ..Default::default() };
    api.scores.list_score_runs(request).await.unwrap().into_inner().score_runs
}

async fn listed(api: &mut Api, deleted: bool) -> Vec<Episode> {
    let request = ListEpisodesRequest { task: lab::TASK.into(), deleted, ..Default::default() };
    api.episodes.list_episodes(request).await.unwrap().into_inner().episodes
}

#[tokio::test]
async fn backup_of_a_running_server_can_be_restored() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    let episodes = push_some(&mut api).await;
    import_scores(&mut api).await;
    let places = tempfile::tempdir().unwrap();
    let (backup, new) = (places.path().join("backup"), places.path().join("new"));
    let target = backup.to_str().unwrap();

    expect_sound(server.data_dir()).await;
    let (sound, text) = server_text(&["backup", target], server.data_dir()).await;
    assert!(sound && text.contains(&format!("{} of them new", episodes.len())), "{text}");
    let (sound, text) = server_text(&["backup", target], server.data_dir()).await;
    assert!(sound && text.contains(" 0 of them new"), "{text}");
    let (sound, text) = server_text(&["restore", target], server.data_dir()).await;
    assert!(!sound && text.contains("not empty"), "{text}");
    let (sound, text) = server_text(&["restore", target], &new).await;
    assert!(sound, "{text}");

    let restored = TestServer::start_over(&new, &["--workers", "0"]).await;
    let mut other = Api::connect(&restored).await;
    assert_eq!(listed(&mut other, false).await, listed(&mut api, false).await);
    assert!(other.download(&episodes[0].id).await == RECORDINGS[0].bytes);
    let runs = score_runs(&mut other).await;
    assert_eq!((runs.len(), &runs), (1, &score_runs(&mut api).await));
    let scores = other.episode_scores(&runs[0].id, &episodes[2].id).await;
    assert_eq!(scores.w, vec![0.5; usize::try_from(episodes[2].steps).unwrap()]);

    // A changed bit is found and named with its episode.
    let rotten = files::blob(&new, &episodes[0].blake3);
    let mut content = std::fs::read(&rotten).unwrap();
    content[100] ^= 1;
    std::fs::write(&rotten, content).unwrap();
    assert!(server_text(&["check", "--fast"], &new).await.0);
    let (sound, text) = server_text(&["check"], &new).await;
    assert!(!sound && text.contains(&episodes[0].blake3) && text.contains(&episodes[0].id), "{text}");
}

#[tokio::test]
async fn deleted_episode_can_be_restored_until_the_sweep() {
    let mut server = TestServer::start_with(&["--workers", "0", "--trash-days", "0"]).await;
    let mut api = Api::connect(&server).await;
    let episodes = push_some(&mut api).await;
    let (first, second) = (&episodes[0], &episodes[1]);
    let delete = |id: &str, force| DeleteEpisodesRequest { episode_ids: vec![id.into()], force };
    let undelete = |id: &str| UndeleteEpisodesRequest { episode_ids: vec![id.into()] };

    api.delete(&first.id).await;
    api.delete(&second.id).await;
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

    // A server sweeps when it starts, and a stop waits for its sweep.
    assert!(server.stop().await);
    server.start_again().await;
    let mut api = Api::connect(&server).await;
    let removed = GetEpisodeRequest { episode_id: first.id.clone() };
    until("the sweep removes the episode", async || api.episodes.get_episode(removed.clone()).await.err()).await;
    assert_eq!(api.episodes.undelete_episodes(undelete(&first.id)).await.unwrap_err().code(), Code::NotFound);
    expect_sound(server.data_dir()).await;
    lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    assert_eq!(listed(&mut api, false).await.len(), episodes.len(), "the recording is a new episode");
}

/// `--min-free-bytes` beyond any disk: uploads and jobs are rejected, and other calls succeed.
#[tokio::test]
async fn nearly_full_disk_rejects_uploads_and_jobs() {
    let (mut server, mut api) = lab::idle().await;
    let episodes = vec![lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap()];
    assert!(server.stop().await);
    let free = u64::MAX.to_string();
    let full = TestServer::start_over(server.data_dir(), &["--workers", "0", "--min-free-bytes", &free]).await;
    let mut api = Api::connect(&full).await;
    let rejected = |status: tonic::Status| expect_error(&status, Code::ResourceExhausted, &["nearly full"]);
    rejected(lab::start(&mut api, lab::TASK, &RECORDINGS[7]).await.unwrap_err());
    rejected(api.submit(lab::TASK, lab::pretrain(4)).await.unwrap_err());
    assert_eq!(listed(&mut api, false).await, episodes);
    api.label(&episodes[0].id, Outcome::Unknown).await.unwrap();
}
