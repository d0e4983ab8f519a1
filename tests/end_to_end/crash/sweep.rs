//! A sweep that is killed leaves a sound folder, and the next sweep completes it.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    command::expect_sound,
    data_folder::swept,
    files::{backdate, blob},
    lab,
    server::TestServer,
    wait::until,
};

#[tokio::test]
async fn interrupted_sweep_is_completed_by_the_next() {
    let (mut server, mut api) = lab::with_task(&["--workers", "0", "--trash-days", "0"]).await;
    for (point, recording) in
        ["sweep.rows_removed", "sweep.committed", "sidecar.removed", "blob.removed"].into_iter().zip(&*lab::RECORDINGS)
    {
        let id = lab::push(&mut api, lab::TASK, recording).await.unwrap().id;
        api.delete(&id).await;
        server.kill().await;
        // A server sweeps when it starts.
        assert!(server.start_where_it_was(Some(point)).await);
        server.ended().await;
        expect_sound(server.data_dir()).await;
        assert!(server.start_where_it_was(None).await);
        api = Api::connect(&server).await;
        until("the sweep removes the episode", async || {
            let removed = api.episodes.get_episode(GetEpisodeRequest { episode_id: id.clone() }).await.err()?;
            assert_eq!(removed.code(), Code::NotFound, "{removed}");
            Some(())
        })
        .await;
        assert_ne!(
            lab::push(&mut api, lab::TASK, recording).await.unwrap().id,
            id,
            "{point}: the recording is a new episode"
        );
    }
    expect_sound(server.data_dir()).await;
}

/// A blob without a row is moved to the trash and deleted by a later sweep, and a kill can follow each step. A recording
/// that no person deleted moves too, and stays in the trash.
#[tokio::test]
async fn interrupted_move_to_the_trash_is_completed_by_the_next_sweep() {
    let flags = ["--workers", "0", "--trash-days", "0"];
    let mut server = TestServer::start_with(&flags).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let episode = lab::push(&mut api, lab::TASK, &lab::RECORDINGS[0]).await.unwrap();
    let trash = server.data_dir().join("blobs/trash");
    let in_trash = |digest: &str| trash.join(&digest[..2]).join(&digest[2..]);
    let unclaimed = add_unclaimed_recording(&server).await;
    for (number, point) in ["trash.sidecars_moved", "trash.moved", "trash.blob_deleted"].into_iter().enumerate() {
        server.kill().await;
        let content = format!("of a worker that died {number}");
        let digest = blake3::hash(content.as_bytes()).to_hex().to_string();
        let (place, trashed) = (blob(server.data_dir(), &digest), in_trash(&digest));
        std::fs::create_dir_all(place.parent().unwrap()).unwrap();
        std::fs::write(&place, &content).unwrap();
        backdate(&place, 4);
        if point == "trash.blob_deleted" {
            drop(swept(server.data_dir(), &flags).await);
        }
        assert!(server.start_where_it_was(Some(point)).await);
        server.ended().await;
        expect_sound(server.data_dir()).await;
        for _ in 0..2 {
            drop(swept(server.data_dir(), &flags).await);
        }
        assert!(!place.exists() && !trashed.exists(), "{point}");
        assert!(in_trash(&unclaimed).exists(), "{point}: a recording is gone");
        assert!(server.start_where_it_was(None).await);
    }
    let request = GetEpisodeRequest { episode_id: episode.id };
    Api::connect(&server).await.episodes.get_episode(request).await.unwrap();
}

/// Adds a recording of another server with its sidecar to the blobs of a server that has no row for it; returns its
/// digest.
async fn add_unclaimed_recording(server: &TestServer) -> String {
    let other = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&other).await;
    lab::create_task(&mut api).await;
    let digest = lab::push(&mut api, lab::TASK, &lab::RECORDINGS[5]).await.unwrap().blake3;
    let (from, to) = (other.data_dir().join("blobs"), server.data_dir().join("blobs"));
    let (folder, name) = digest.split_at(2);
    std::fs::create_dir_all(to.join(folder)).unwrap();
    for entry in std::fs::read_dir(from.join(folder)).unwrap() {
        let entry = entry.unwrap();
        if entry.file_name().to_str().unwrap().starts_with(name) {
            let place = to.join(folder).join(entry.file_name());
            std::fs::copy(entry.path(), &place).unwrap();
            backdate(&place, 4);
        }
    }
    digest
}
