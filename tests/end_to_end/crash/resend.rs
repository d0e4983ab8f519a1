//! The bytes that a client sends twice when the server dies during a fast upload.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use bytes::Bytes;
use futures::stream;
use gleaner_proto::v1::*;

use crate::support::{
    api::Api,
    lab::{self, Recording},
};

const CHUNK: u64 = 256 << 10;
/// The documented limit.
const MOST: u64 = 8 << 20;

#[tokio::test]
async fn at_most_8_mib_are_sent_twice() {
    let (mut server, mut api) = lab::idle().await;
    // The digest is checked when the upload is finished, which never happens.
    let bytes: Bytes = vec![7; 64 << 20].into();
    let (name, cohort) = ("large.mcap".to_owned(), String::new());
    let recording = Recording { name, bytes: bytes.clone(), outcome: Outcome::Unknown, cohort };
    let upload_id = lab::start(&mut api, lab::TASK, &recording).await.unwrap().upload_id;

    let sent = Arc::new(AtomicU64::new(0));
    let (enough, enough_receiver) = tokio::sync::oneshot::channel();
    let begin = (Arc::clone(&sent), upload_id.clone(), bytes, Some(enough));
    let messages = stream::unfold(begin, |(sent, upload_id, bytes, mut enough)| async move {
        let offset = sent.fetch_add(CHUNK, Ordering::Relaxed);
        if offset > 24 << 20 {
            // The receiver is dropped after the first message.
            let _ = enough.take().map(|enough: tokio::sync::oneshot::Sender<()>| enough.send(()));
        }
        let at = usize::try_from(offset).unwrap();
        let data = (at < bytes.len()).then(|| bytes.slice(at..at + usize::try_from(CHUNK).unwrap()))?;
        let message = WriteUploadRequest { upload_id: upload_id.clone(), offset, data };
        Some((message, (sent, upload_id, bytes, enough)))
    });
    let mut writing = api.clone();
    let writing = tokio::spawn(async move { writing.episodes.write_upload(messages).await });
    enough_receiver.await.unwrap();
    server.kill().await;
    writing.await.unwrap().unwrap_err();
    let sent = sent.load(Ordering::Relaxed);

    assert!(server.start_where_it_was(None).await);
    let mut api = Api::connect(&server).await;
    let committed = api.committed_size(&upload_id).await.unwrap();
    eprintln!("{} of {sent} bytes have to be sent again", sent - committed);
    assert!(sent - committed <= MOST, "{sent} bytes were sent, {committed} of them are committed");
    let again = lab::start(&mut api, lab::TASK, &recording).await.unwrap();
    assert_eq!(again.committed_size, committed, "a new client receives the same size");
}
