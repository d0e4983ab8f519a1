//! A damaged checkpoint is never resumed.

use std::{collections::BTreeSet, fs, path::PathBuf};

use gleaner_proto::v1::JobState;

use crate::support::{api::Api, files, lab, server::TestServer};

const STEPS: u32 = 24;

fn blobs(server: &TestServer) -> BTreeSet<PathBuf> {
    files::blobs(server.data_dir()).into_iter().collect()
}

/// A truncated, changed or missing checkpoint: the job starts again and ends with the same result.
#[tokio::test]
async fn damaged_checkpoint_is_never_resumed() {
    let (mut server, mut api, _) = lab::with_episodes(&[]).await;
    let recordings = blobs(&server);
    let straight = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;
    let losses = api.metric(&straight.id, "loss").await;
    // A checkpoint may exist for a moment after its job, but not after the server.
    assert!(server.stop().await);
    let result: BTreeSet<_> = blobs(&server).difference(&recordings).cloned().collect();
    assert!(server.start_where_it_was(None).await);
    api = Api::connect(&server).await;
    for damage in ["truncated", "changed", "missing"] {
        let job = api.submit(lab::TASK, lab::pretrain(STEPS)).await.unwrap();
        server.kill().await;
        // After the second checkpoint is committed, before the first one is removed.
        assert!(server.start_where_it_was(Some("checkpoint.committed=2")).await);
        server.ended().await;
        let before: BTreeSet<_> = recordings.union(&result).cloned().collect();
        let checkpoints: Vec<_> = blobs(&server).difference(&before).cloned().collect();
        assert!(!checkpoints.is_empty());
        for checkpoint in &checkpoints {
            let mut bytes = fs::read(checkpoint).unwrap();
            match damage {
                "truncated" => bytes.truncate(bytes.len() / 2),
                "changed" => *bytes.last_mut().unwrap() ^= 1,
                _ => {}
            }
            fs::write(checkpoint, bytes).unwrap();
            if damage == "missing" {
                fs::remove_file(checkpoint).unwrap();
            }
        }
        assert!(server.start_where_it_was(None).await);
        api = Api::connect(&server).await;
        let ended = api.watch(&job.id).await;
        assert_eq!(ended.state(), JobState::Succeeded, "{damage}: {}", ended.error);
        assert_eq!(api.metric(&job.id, "loss").await, losses, "{damage}");
        let left: BTreeSet<_> = blobs(&server).difference(&recordings).cloned().collect();
        assert!(result.is_subset(&left), "{damage}: the result differs");
    }
}
