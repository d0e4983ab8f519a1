//! The sweep of a data folder whose blobs are in a bucket.

use std::collections::BTreeSet;

use gleaner_bucket::testing::TestStore;
use gleaner_proto::v1::Episode;

use crate::support::{
    api::Api,
    blob_store::{copies, forget_copies, start},
    command::expect_sound,
    data_folder::swept,
    lab::{self, RECORDINGS},
};

/// The names of the objects of blobs, those in the trash too.
fn objects(store: &TestStore) -> BTreeSet<String> {
    let listed = store.bucket("one").unwrap().list("blobs").unwrap();
    listed.into_iter().map(|object| object.name).collect()
}

#[tokio::test]
async fn a_sweep_removes_the_object_and_the_copy_of_a_deleted_episode() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let flags = ["--workers", "0", "--trash-days", "0"];
    let mut server = start(&store, "one", &flags).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let deleted = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let kept = lab::push(&mut api, lab::TASK, &RECORDINGS[1]).await.unwrap();
    let name = |episode: &Episode| format!("blobs/{}/{}", &episode.blake3[..2], &episode.blake3[2..]);
    assert_eq!(objects(&store), BTreeSet::from([name(&deleted), name(&kept)]));
    api.delete(&deleted.id).await;
    assert!(server.stop().await);

    // The data folder names its bucket.
    let sweeping = swept(server.data_dir(), &flags).await;
    assert_eq!(objects(&store), BTreeSet::from([name(&kept)]));
    assert_eq!(copies(server.data_dir()), 1);
    let mut api = Api::connect(&sweeping).await;
    forget_copies(server.data_dir());
    assert!(api.download(&kept.id).await == RECORDINGS[1].bytes);
    assert_ne!(lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap().id, deleted.id, "a new episode");
    assert_eq!(objects(&store), BTreeSet::from([name(&deleted), name(&kept)]));
    expect_sound(server.data_dir()).await;
}
