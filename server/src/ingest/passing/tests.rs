//! Recordings that are inspected and not stored: their content, and that no file stays.

use futures::stream;

use super::*;
use crate::{
    error::Kind,
    ingest::testing::{Fixture, REFUSING, playing, playing_with, real, recording},
    lock::StandbyLock,
};

const FOLDERS: [&str; 4] = ["blobs", "uploads", "cache", "tmp"];

async fn pass(f: &Fixture, size: Option<u64>, chunks: Vec<Result<Bytes>>) -> Result<Passing> {
    let declared = Declared { file_name: "reach.mcap".into(), size_bytes: size, summary: None };
    f.ingest.pass(&Client::Server, &f.task.spec, declared, stream::iter(chunks)).await
}

fn chunks(bytes: &[u8]) -> Vec<Result<Bytes>> {
    bytes.chunks(100).map(|chunk| Ok(Bytes::copy_from_slice(chunk))).collect()
}

#[tokio::test]
async fn a_recording_is_read_and_removed() {
    let f = real("none", &[]).await;
    let bytes = recording(&f.task, 12);
    let passing = pass(&f, Some(bytes.len() as u64), chunks(&bytes)).await.unwrap();
    assert_eq!((passing.report.steps, passing.frames.steps()), (12, 12));
    assert_eq!(passing.frames.numbers(3..4).unwrap().action, [-3.0]);
    let held = f.files(&FOLDERS);
    assert!(!held.is_empty() && held.iter().all(|path| path.extension().is_none_or(|kind| kind != "mcap")), "{held:?}");
    assert_eq!(f.ingest.passing.available_permits(), AT_ONCE - 1, "its steps are held");
    drop(passing);
    assert!(f.files(&FOLDERS).is_empty(), "{:?}", f.files(&FOLDERS));
    assert_eq!(f.ingest.passing.available_permits(), AT_ONCE);
    assert!(pass(&f, None, chunks(&bytes)).await.is_ok(), "its size need not be known");
}

#[tokio::test]
async fn an_unusable_recording_is_rejected_and_removed() {
    let f = playing(REFUSING).await;
    let refused = pass(&f, None, chunks(b"recording")).await.unwrap_err();
    assert!(refused.kind() == Kind::Invalid && refused.message().contains("reach.mcap holds no"), "{refused}");
    for (declared, word) in [(8, "more"), (10, "less")] {
        let lied = pass(&f, Some(declared), chunks(b"recording")).await.unwrap_err();
        assert!(lied.message().starts_with("open.size_bytes: ") && lied.message().contains(word), "{lied}");
    }
    let broken = pass(&f, None, vec![Ok("reco".into()), Err(Error::cancelled("gone"))]).await.unwrap_err();
    assert_eq!(broken.kind(), Kind::Cancelled);
    assert!(f.files(&FOLDERS).is_empty(), "{:?}", f.files(&FOLDERS));
}

#[tokio::test]
async fn a_recording_above_the_limit_is_refused_early() {
    let f = real("none", &["--max-upload-bytes", "8"]).await;
    for declared in [None, Some(9)] {
        let refused = pass(&f, declared, chunks(b"recording")).await.unwrap_err();
        assert!(refused.kind() == Kind::Exhausted && refused.message().contains("--max-upload-bytes"), "{refused}");
    }
    let endless = stream::repeat_with(|| Ok(Bytes::from_static(b"123456")));
    let refused = f.ingest.pass(&Client::Server, &f.task.spec, Declared::default(), endless).await.unwrap_err();
    assert_eq!(refused.kind(), Kind::Exhausted);
    assert!(f.files(&FOLDERS).is_empty());
}

#[tokio::test]
async fn a_recording_that_states_too_much_is_refused_before_its_first_byte() {
    let f = playing_with(REFUSING, &["--max-records", "11"]).await;
    let summary = Some(RecordingSummary { messages: 12, ..RecordingSummary::default() });
    for size_bytes in [None, Some(9)] {
        let declared = Declared { size_bytes, summary: summary.clone(), ..Declared::default() };
        let refused =
            f.ingest.pass(&Client::Server, &f.task.spec, declared, stream::pending().boxed()).await.unwrap_err();
        assert_eq!(refused.kind(), Kind::Exhausted);
        for part in ["open.summary.messages: ", "12", "11 (--max-records)"] {
            assert!(refused.message().contains(part), "{refused}");
        }
    }
    assert!(f.files(&FOLDERS).is_empty());
}

#[tokio::test]
async fn the_number_of_concurrent_recordings_is_limited() {
    let f = playing(REFUSING).await;
    let waits = || f.ingest.pass(&Client::Server, &f.task.spec, Declared::default(), stream::pending().boxed());
    let mut waiting = Vec::new();
    for _ in 0..AT_ONCE {
        let mut one = Box::pin(waits());
        assert!(futures::poll!(&mut one).is_pending());
        waiting.push(one);
    }
    assert_eq!(waits().await.unwrap_err().kind(), Kind::Exhausted);
    waiting.pop();
    assert_eq!(pass(&f, None, chunks(b"recording")).await.unwrap_err().kind(), Kind::Invalid, "there is room again");
}

#[tokio::test]
async fn files_left_by_a_crash_are_removed_at_the_next_start() {
    let mut f = playing(REFUSING).await;
    let folder = f.dir.path().join("tmp/passing-x");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("recording.mcap"), b"half").unwrap();
    let standby = StandbyLock::join(f.dir.path()).unwrap();
    f.reopen().await;
    assert!(folder.exists(), "it may be the standby's");
    drop(standby);
    f.reopen().await;
    assert!(!folder.exists());
}
