//! What a client has to send again when the server dies while it sends as fast as it can.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use bytes::Bytes;
use futures::stream;
use gleaner_proto::v1::*;

use crate::{
    api::Api,
    lab::{self, Recording},
    server::TestServer,
};

const PIECE: u64 = 256 << 10;
/// What is promised.
const MOST: u64 = 8 << 20;

#[tokio::test]
async fn at_most_8_mib_are_sent_twice() {
    let mut server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    // Its digest is looked at when it is finished, which it never is.
    let bytes: Bytes = vec![7; 64 << 20].into();
    let (name, cohort) = ("large.mcap".to_owned(), String::new());
    let recording = Recording { name, bytes: bytes.clone(), outcome: Outcome::Unknown, cohort };
    let upload_id = lab::start(&mut api, lab::TASK, &recording).await.unwrap().upload_id;

    let sent = Arc::new(AtomicU64::new(0));
    let (enough, sees_enough) = tokio::sync::oneshot::channel();
    let begin = (Arc::clone(&sent), upload_id.clone(), bytes, Some(enough));
    let messages = stream::unfold(begin, |(sent, upload_id, bytes, mut enough)| async move {
        let offset = sent.fetch_add(PIECE, Ordering::Relaxed);
        if offset > 24 << 20 {
            // The receiver is gone once it has seen it.
            let _ = enough.take().map(|enough: tokio::sync::oneshot::Sender<()>| enough.send(()));
        }
        let at = usize::try_from(offset).unwrap();
        let data = (at < bytes.len()).then(|| bytes.slice(at..at + usize::try_from(PIECE).unwrap()))?;
        let message = WriteUploadRequest { upload_id: upload_id.clone(), offset, data };
        Some((message, (sent, upload_id, bytes, enough)))
    });
    let mut writing = api.clone();
    let writing = tokio::spawn(async move { writing.episodes.write_upload(messages).await });
    sees_enough.await.unwrap();
    server.kill().await;
    writing.await.unwrap().unwrap_err();
    let sent = sent.load(Ordering::Relaxed);

    assert!(server.start_where_it_was(None).await);
    let mut api = Api::connect(&server).await;
    let committed = api.episodes.get_upload(GetUploadRequest { upload_id }).await.unwrap().into_inner().committed_size;
    eprintln!("{} of {sent} bytes are sent again", sent - committed);
    assert!(sent - committed <= MOST, "{sent} bytes were sent, {committed} of them are committed");
    let again = lab::start(&mut api, lab::TASK, &recording).await.unwrap();
    assert_eq!(again.committed_size, committed, "a client that knows nothing is told the same");
}
