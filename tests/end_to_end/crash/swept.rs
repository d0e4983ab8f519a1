//! A sweep that dies in its middle leaves everything sound, and the next one goes on.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::{api::Api, keeping::command, lab, server::TestServer};

#[tokio::test]
async fn a_sweep_that_is_cut_anywhere_is_gone_on_with() {
    let mut server = TestServer::start_with(&["--workers", "0", "--trash-days", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    for (point, recording) in
        ["sweep.rows_removed", "sweep.committed", "blob.removed"].into_iter().zip(&*lab::RECORDINGS)
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
