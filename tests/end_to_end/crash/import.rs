//! An import that is killed leaves the whole run or none of it, and its repetition returns one run.

use gleaner_proto::v1::*;

use crate::support::{api::Api, command::expect_sound, lab};

#[tokio::test]
async fn interrupted_import_is_stored_whole_or_not_at_all() {
    let (mut server, mut api, _) = lab::with_episodes(&["--workers", "0"]).await;
    let request = CreateSnapshotRequest { task: lab::TASK.into(), rule: None };
    let snapshot = api.snapshots.create_snapshot(request).await.unwrap().into_inner().snapshot.unwrap().id;
    for (point, before) in [("import.rows_written", 0), ("import.committed", 1)] {
        let messages = lab::import(&mut api, &snapshot, point).await;
        server.kill().await;
        assert!(server.start_where_it_was(Some(point)).await);
        api = Api::connect(&server).await;
        api.scores.import_scores(tokio_stream::iter(messages.clone())).await.unwrap_err();
        server.ended().await;
        expect_sound(server.data_dir()).await;
        assert!(server.start_where_it_was(None).await);
        api = Api::connect(&server).await;
        let runs = async |api: &mut Api| {
            let request = ListScoreRunsRequest { task: lab::TASK.into(), ..Default::default() };
            let all = api.scores.list_score_runs(request).await.unwrap().into_inner().score_runs;
            all.into_iter().filter(|run| lab::given(&run.settings)["source"] == point).collect::<Vec<_>>()
        };
        assert_eq!(runs(&mut api).await.len(), before, "{point}");
        let run = api.scores.import_scores(tokio_stream::iter(messages)).await.unwrap().into_inner().score_run;
        assert_eq!(runs(&mut api).await, [run.unwrap()], "{point}");
    }
    expect_sound(server.data_dir()).await;
}
