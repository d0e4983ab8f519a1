//! A sweep that dies in its middle leaves everything sound, and the next one goes on.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::{api::Api, lab, maintenance::command, server::TestServer};

#[tokio::test]
async fn a_sweep_that_is_cut_anywhere_is_gone_on_with() {
    let mut server = TestServer::start_with(&["--workers", "0", "--trash-days", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    for (point, recording) in
        ["sweep.rows_removed", "sweep.committed", "sidecar.removed", "blob.removed"].into_iter().zip(&*lab::RECORDINGS)
    {
        let id = lab::push(&mut api, lab::TASK, recording).await.unwrap().id;
        let delete = DeleteEpisodesRequest { episode_ids: vec![id.clone()], force: false };
        api.episodes.delete_episodes(delete).await.unwrap();
        server.kill().await;
        // It sweeps when it starts.
        assert!(server.start_where_it_was(Some(point)).await);
        server.died().await;
        let (sound, said) = command(&["check"], server.data_dir()).await;
        assert!(sound, "{point}: {said}");
        assert!(server.start_where_it_was(None).await);
        api = Api::connect(&server).await;
        let swept = async {
            let gone = GetEpisodeRequest { episode_id: id.clone() };
            loop {
                match api.episodes.get_episode(gone.clone()).await {
                    Ok(_) => tokio::task::yield_now().await,
                    Err(status) => break assert_eq!(status.code(), Code::NotFound, "{status}"),
                }
            }
        };
        tokio::time::timeout(std::time::Duration::from_secs(60), swept).await.expect("the sweep takes too long");
        assert_ne!(lab::push(&mut api, lab::TASK, recording).await.unwrap().id, id, "{point}: it can be pushed again");
    }
    let (sound, said) = command(&["check"], server.data_dir()).await;
    assert!(sound, "{said}");
}

/// A blob that no row names is moved to the trash, and deleted from there by a later sweep; each step may be the last.
/// A recording that no person deleted moves too, and stays in the trash.
#[tokio::test]
async fn a_move_to_the_trash_that_is_cut_anywhere_is_gone_on_with() {
    let flags = ["--workers", "0", "--trash-days", "0"];
    let mut server = TestServer::start_with(&flags).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let episode = lab::push(&mut api, lab::TASK, &lab::RECORDINGS[0]).await.unwrap();
    let blobs = server.data_dir().join("blobs");
    let lost = lose_a_recording(&server).await;
    for (number, point) in ["trash.sidecars_moved", "trash.moved", "trash.blob_deleted"].into_iter().enumerate() {
        server.kill().await;
        let content = format!("of a worker that died {number}");
        let digest = blake3::hash(content.as_bytes()).to_hex().to_string();
        let (folder, name) = digest.split_at(2);
        let (place, trash) = (blobs.join(folder).join(name), blobs.join("trash").join(folder).join(name));
        std::fs::create_dir_all(place.parent().unwrap()).unwrap();
        std::fs::write(&place, &content).unwrap();
        let long_ago = std::time::SystemTime::now() - std::time::Duration::from_secs(4 * 24 * 60 * 60);
        std::fs::File::open(&place).unwrap().set_modified(long_ago).unwrap();
        if point == "trash.blob_deleted" {
            drop(crate::operator::folder::swept(server.data_dir(), &flags).await);
        }
        assert!(server.start_where_it_was(Some(point)).await);
        server.died().await;
        let (sound, text) = command(&["check"], server.data_dir()).await;
        assert!(sound, "{point}: {text}");
        for _ in 0..2 {
            drop(crate::operator::folder::swept(server.data_dir(), &flags).await);
        }
        assert!(!place.exists() && !trash.exists(), "{point}");
        let (folder, name) = lost.split_at(2);
        assert!(blobs.join("trash").join(folder).join(name).exists(), "{point}: a recording is gone");
        assert!(server.start_where_it_was(None).await);
    }
    let request = GetEpisodeRequest { episode_id: episode.id };
    Api::connect(&server).await.episodes.get_episode(request).await.unwrap();
}

/// Puts a recording with its sidecar among the blobs of a server that has no row of it: those of a second lab. Gives its
/// digest.
async fn lose_a_recording(server: &TestServer) -> String {
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
            let long_ago = std::time::SystemTime::now() - std::time::Duration::from_secs(4 * 24 * 60 * 60);
            std::fs::File::open(place).unwrap().set_modified(long_ago).unwrap();
        }
    }
    digest
}
