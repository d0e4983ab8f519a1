//! Blobs of workers whose data folder holds them itself; those of a bucket are tested end to end.

use gleaner_core::PretrainSpec;

use super::*;
use crate::{
    domain::{
        order::{JobOrder, Queueing},
        snapshot::RoleRule,
    },
    jobs::testing::Bench,
};

#[tokio::test]
async fn a_blob_is_located_without_a_url_where_the_folder_holds_it() {
    let bench = Bench::empty().await;
    let id = bench.blobs().put(b"steps").unwrap();
    for (accept_url, fetch) in [(false, false), (true, true), (false, true)] {
        let found = bench.jobs.locate_blob(&id, accept_url, fetch).await.unwrap();
        assert!(found.size_bytes == 5 && found.url.is_none());
        let gone = BlobId::from(blake3::hash(b"gone"));
        let error = bench.jobs.locate_blob(&gone, accept_url, fetch).await.unwrap_err();
        assert!(error.kind() == Kind::NotFound && error.message().contains(gone.as_str()), "{error}");
    }
}

/// The reason reaches the worker: an internal error would not.
#[tokio::test]
async fn only_a_file_that_was_handed_over_whole_is_stored() {
    let bench = Bench::new().await;
    let order = JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec: PretrainSpec::default() };
    bench.jobs.submit(&bench.task.id, order, Queueing::default()).await.unwrap();
    let (attempt, _) = bench.claim().await;
    let id = BlobId::from(blake3::hash(b"steps"));
    let handed = bench.dir.path().join("tmp").join(format!("handed-{id}"));
    assert_eq!(bench.jobs.store_blob(&attempt, &id).await.unwrap_err().kind(), Kind::NotFound);
    std::fs::write(&handed, b"ste").unwrap();
    let error = bench.jobs.store_blob(&attempt, &id).await.unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("digest"), "{error}");
    std::fs::write(&handed, b"steps").unwrap();
    for _ in 0..2 {
        bench.jobs.store_blob(&attempt, &id).await.unwrap();
    }
    assert_eq!(bench.blobs().get(&id).unwrap(), b"steps");
    assert!(!handed.exists());
}
