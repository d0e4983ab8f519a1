//! The upload contract, clause by clause: committed bytes are on disk and stay, little is sent twice, and a returning
//! client resumes at the committed size, whatever happened to the one before it.

mod model;

use std::{
    fs::File,
    time::{Duration, SystemTime},
};

use futures::{future::join_all, stream};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

use super::{
    Started,
    claim::Claims,
    testing::{Fixture, USABLE, chunk, playing},
};
use crate::{
    domain::{episode::Upload, id::EpisodeId},
    error::{Error, Kind},
    store::testing,
};

/// A message of the stream.
const PIECE: usize = 256 << 10;

fn content(bytes: usize) -> Vec<u8> {
    (0..=250).cycle().take(bytes).collect()
}

/// The committed size as a client reads it.
async fn committed(f: &Fixture, upload: &Upload) -> u64 {
    f.ingest.status(&upload.id).await.unwrap().committed
}

/// While a client sends as fast as it can, the uncommitted part of its data stays small: with a stream's window of 4
/// MiB and a message of 2 MiB on their way, under 8 MiB.
#[tokio::test]
async fn at_most_two_mebibytes_are_sent_twice() {
    let f = playing(USABLE).await;
    let content = content(5 << 20);
    let upload = f.start(&content).await;
    let chunks = stream::unfold(0, |at: usize| {
        let (f, upload, content) = (&f, &upload, &content);
        async move {
            let again = at as u64 - committed(f, upload).await;
            assert!(again <= 2 << 20, "{again} bytes of {at} are not committed");
            (at < content.len()).then(|| (Ok(chunk(&upload.id, at, &content[at..at + PIECE])), at + PIECE))
        }
    });
    assert_eq!(f.ingest.write(chunks).await.unwrap(), content.len() as u64);
    assert!(std::fs::read(f.ingest.part_path(&upload.id)).unwrap() == content);
}

#[tokio::test]
async fn equal_content_pushed_concurrently_is_one_episode_and_one_blob() {
    let f = playing(USABLE).await;
    let first = f.start(b"recording").await;
    let others = join_all((0..7).map(|_| f.beside(&first))).await;
    let finished = join_all(others.iter().chain([&first]).map(|upload| {
        let f = &f;
        async move {
            f.write(&upload.id, 0, b"recording").await?;
            Ok::<_, Error>(f.ingest.finish(&upload.id).await?.episode.id)
        }
    }))
    .await;
    let ids: Vec<EpisodeId> = finished.into_iter().map(Result::unwrap).collect();
    assert!(ids.iter().all(|id| *id == ids[0]), "{ids:?}");
    assert_eq!(f.ingest.blobs().list().unwrap().len(), 1);
    assert!(f.files(&["uploads", "tmp"]).is_empty());
}

/// A second client does not take the upload of an active one, and gets its own.
#[tokio::test]
async fn two_clients_that_push_one_file_do_not_disturb_each_other() {
    let f = playing(USABLE).await;
    let content = content(1 << 16);
    let first = f.start(&content).await;
    let (send, chunks) = mpsc::channel(1);
    let dripping = async {
        let mut at = 0;
        // Until the receiver, and with it the second client, has its answer.
        while at < content.len() && send.send(Ok(chunk(&first.id, at, &content[at..=at]))).await.is_ok() {
            at += 1;
            tokio::task::yield_now().await;
        }
    };
    let second = tokio::select! {
        second = f.start(&content) => second,
        written = async { tokio::join!(f.ingest.write(ReceiverStream::new(chunks)), dripping).0 } => {
            panic!("the second client still waits: {written:?}")
        }
    };
    assert_ne!(second.id, first.id);
    assert_eq!(second.committed, 0);
}

/// Its connection may look alive for half a minute. The next client does not wait for that, and sends no committed byte
/// again.
#[tokio::test]
async fn an_upload_of_a_dead_client_passes_to_the_next_client() {
    let mut f = playing(USABLE).await;
    f.ingest.claims = Claims::with_patience(Duration::from_millis(20));
    let upload = f.start(b"recording").await;
    let (send, chunks) = mpsc::channel(1);
    let ingest = f.ingest.clone();
    let dead = tokio::spawn(async move { ingest.write(ReceiverStream::new(chunks)).await });
    send.send(Ok(chunk(&upload.id, 0, b"reco"))).await.unwrap();
    let mut polls = tokio::time::interval(Duration::from_millis(5));
    while committed(&f, &upload).await == 0 {
        polls.tick().await;
    }
    let next = f.start(b"recording").await;
    assert_eq!((&next.id, next.committed), (&upload.id, 4));
    assert_eq!(f.write(&next.id, 4, b"rding").await.unwrap(), 9);
    assert_eq!(dead.await.unwrap().unwrap_err().kind(), Kind::Unavailable);
    assert_eq!(f.ingest.finish(&next.id).await.unwrap().episode.size_bytes, 9);
}

/// The upload that a second client waits for ends: the answer is the episode.
#[tokio::test]
async fn a_client_that_waits_for_an_ended_upload_gets_its_episode() {
    let f = playing(USABLE).await;
    let upload = f.start(b"recording").await;
    f.write(&upload.id, 0, b"recording").await.unwrap();
    // It is held while it is inspected.
    let finishing = f.ingest.finish(&upload.id);
    let (finished, started) = tokio::join!(finishing, f.ingest.start(f.new_upload(b"recording")));
    let id = finished.unwrap().episode.id;
    match started.unwrap() {
        Started::Existing(episode) => assert_eq!(episode.id, id),
        // It claimed before the finish began, and resumes an upload that is complete.
        Started::Open(open) => {
            assert_eq!((&open.id, open.committed), (&upload.id, 9));
            assert_eq!(f.ingest.finish(&open.id).await.unwrap_err().kind(), Kind::NotFound);
        }
    }
}

/// A client returns after its last answer was lost: no part of its upload stays.
#[tokio::test]
async fn stored_content_leaves_no_upload_behind() {
    let f = playing(USABLE).await;
    let first = f.start(b"recording").await;
    let other = f.beside(&first).await;
    f.write(&first.id, 0, b"recording").await.unwrap();
    f.write(&other.id, 0, b"reco").await.unwrap();
    let id = f.ingest.finish(&first.id).await.unwrap().episode.id;
    let Started::Existing(found) = f.ingest.start(f.new_upload(b"recording")).await.unwrap() else {
        panic!("opened again")
    };
    assert_eq!(found.id, id);
    assert!(f.store.uploads().await.unwrap().is_empty());
    assert!(f.files(&["uploads", "tmp"]).is_empty());
}

/// Days later it resumes; weeks after its last byte it does not.
#[tokio::test]
async fn an_upload_is_kept_from_its_last_byte_on() {
    let mut f = playing(USABLE).await;
    let (quiet, busy) = (f.start(b"forgotten").await, f.start(b"recording").await);
    for upload in [&quiet, &busy] {
        f.write(&upload.id, 0, b"reco").await.unwrap();
    }
    let month = Duration::from_secs(30 * 24 * 60 * 60);
    testing::run(&f.store, "update uploads set created_at = 0").await;
    let part = File::options().write(true).open(f.ingest.part_path(&quiet.id)).unwrap();
    part.set_modified(SystemTime::now() - month).unwrap();

    f.reopen().await;
    let held = f.ingest.claims.take(&quiet.id).await;
    assert_eq!(f.ingest.forget_abandoned(SystemTime::now()).await.unwrap(), 0, "a client has come back");
    drop(held);
    assert_eq!(f.ingest.forget_abandoned(SystemTime::now()).await.unwrap(), 1);
    assert_eq!(f.ingest.status(&quiet.id).await.unwrap_err().kind(), Kind::NotFound);
    assert!(!f.ingest.part_path(&quiet.id).exists());
    let again = f.start(b"recording").await;
    assert_eq!((&again.id, again.committed), (&busy.id, 4));
    assert_eq!(f.write(&again.id, 4, b"rding").await.unwrap(), 9);
}

/// A lost part is not started again under the same name: its name would not be on disk.
#[tokio::test]
async fn a_missing_part_is_an_error() {
    let f = playing(USABLE).await;
    let upload = f.start(b"recording").await;
    std::fs::remove_file(f.ingest.part_path(&upload.id)).unwrap();
    assert_eq!(f.write(&upload.id, 0, b"reco").await.unwrap_err().kind(), Kind::Internal);
    assert_eq!(committed(&f, &upload).await, 0);
}
