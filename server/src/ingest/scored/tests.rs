//! Copies with scores: how clients share them.

use std::collections::BTreeMap;

use futures::TryStreamExt as _;

use super::{
    super::testing::{USABLE, playing},
    *,
};
use crate::error::Kind;

fn client(name: &str) -> Client {
    Client::Token(name.into())
}

#[tokio::test]
async fn one_client_s_unread_copies_leave_room_for_another_s() {
    let f = playing(USABLE).await;
    let episode = f.push(b"recording").await.unwrap().episode;
    let copy = async |name: &str| {
        let kept = Kept { first_step: 0, scores: Vec::new(), about: BTreeMap::new() };
        f.ingest.scored_copy(&client(name), &f.task.spec, &episode, kept).await
    };
    let mut unread = Vec::new();
    for _ in 1..AT_ONCE {
        unread.push(copy("slow").await.unwrap());
    }
    let refused = copy("slow").await.err().unwrap();
    assert!(refused.kind() == Kind::Exhausted && refused.message().contains("3 by this client"), "{refused}");
    let other = copy("other").await.unwrap();
    assert_eq!(copy("third").await.err().unwrap().kind(), Kind::Exhausted, "all are taken");
    let read: Vec<Bytes> = other.bytes.try_collect().await.unwrap();
    assert_eq!(read.concat().len() as u64, other.size_bytes);
    copy("third").await.unwrap();
    drop(unread.pop());
    copy("slow").await.unwrap();
}
