//! A checkpoint that the disk has spoilt is never resumed from.

use std::{collections::BTreeSet, fs, path::PathBuf};

use gleaner_proto::v1::JobState;

use crate::{api::Api, lab, server::TestServer};

const STEPS: u32 = 24;

fn blobs(server: &TestServer) -> BTreeSet<PathBuf> {
    super::blob_files(server.data_dir())
}

/// Cut, changed or gone: the job begins anew, says so to nobody but the log, and ends as if nothing had happened.
#[tokio::test]
async fn a_torn_checkpoint_is_never_chosen() {
    let mut server = TestServer::start().await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    let recordings = blobs(&server);
    let straight = api.succeed(lab::TASK, lab::pretrain(STEPS)).await;
    let losses = api.metric(&straight.id, "loss").await;
    // A checkpoint may outlive its job by a moment, but not the server.
    assert!(server.stop().await);
    let result: BTreeSet<_> = blobs(&server).difference(&recordings).cloned().collect();
    assert!(server.start_where_it_was(None).await);
    api = Api::connect(&server).await;
    for damage in ["cut", "changed", "gone"] {
        let job = api.submit(lab::TASK, lab::pretrain(STEPS)).await.unwrap();
        server.kill().await;
        // Right after the second checkpoint is named, before the first one goes.
        assert!(server.start_where_it_was(Some("checkpoint.committed=2")).await);
        server.died().await;
        let before: BTreeSet<_> = recordings.union(&result).cloned().collect();
        let checkpoints: Vec<_> = blobs(&server).difference(&before).cloned().collect();
        assert!(!checkpoints.is_empty());
        for checkpoint in &checkpoints {
            let mut bytes = fs::read(checkpoint).unwrap();
            match damage {
                "cut" => bytes.truncate(bytes.len() / 2),
                "changed" => *bytes.last_mut().unwrap() ^= 1,
                _ => {}
            }
            fs::write(checkpoint, bytes).unwrap();
            if damage == "gone" {
                fs::remove_file(checkpoint).unwrap();
            }
        }
        assert!(server.start_where_it_was(None).await);
        api = Api::connect(&server).await;
        let ended = api.watch(&job.id).await;
        assert_eq!(ended.state(), JobState::Succeeded, "{damage}: {}", ended.error);
        assert_eq!(api.metric(&job.id, "loss").await, losses, "{damage}");
        let left: BTreeSet<_> = blobs(&server).difference(&recordings).cloned().collect();
        assert!(result.is_subset(&left), "{damage}: the result is another one");
    }
}
