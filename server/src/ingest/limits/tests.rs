//! What a client declares about a recording is compared with the limits before its first byte, and never believed.

use std::{collections::BTreeMap, sync::atomic::Ordering};

use gleaner_recording::{CameraSpec, RecordingSummary, summarize, written_mapping};

use crate::{
    domain::{client::Client, episode::NewUpload},
    error::Kind,
    ingest::{
        Declared, Started,
        testing::{Fixture, USABLE, playing, playing_with, real, recording},
    },
};

/// A summary of ten minutes at 10 Hz, in the dialect of recorded sessions.
fn ten_minutes() -> RecordingSummary {
    let topics = ["/robot/state", "/robot/action"].map(|topic| (topic.to_owned(), 6000));
    RecordingSummary {
        duration_ns: 600_000_000_000,
        messages: 12_000,
        channels: 2,
        schemas: 2,
        largest_chunk_bytes: 65_536,
        topics: BTreeMap::from(topics),
    }
}

fn declared(f: &Fixture, content: &[u8], summary: RecordingSummary) -> NewUpload {
    NewUpload { summary: Some(summary), ..f.new_upload(content) }
}

/// The refusal of an upload with this summary, for which no file and no row is left.
async fn refusal(f: &Fixture, new: NewUpload) -> String {
    let checked = f.ingest.check(new.clone()).await.unwrap_err();
    let error = f.ingest.start(new).await.unwrap_err();
    assert_eq!((error.kind(), error.message()), (Kind::Exhausted, checked.message()));
    assert!(f.store.uploads().await.unwrap().is_empty() && f.files(&["uploads"]).is_empty());
    error.message().to_owned()
}

#[tokio::test]
async fn declared_contents_above_a_limit_are_rejected_with_setting_and_number() {
    for (flag, value, stated) in [
        ("--max-records", "11999", "states 12000 messages"),
        ("--max-channels", "1", "states 2 channels"),
        ("--max-chunk-bytes", "65535", "states 65536 bytes in a chunk"),
        ("--max-name-bytes", "12", "states 13 bytes in a topic's name"),
        ("--inspect-memory-bytes", "287999", "reading 600 s with 6000 steps takes at least 288000 bytes"),
    ] {
        let f = playing_with(USABLE, &[flag, value]).await;
        let message = refusal(&f, declared(&f, b"recording", ten_minutes())).await;
        for part in [flag, value, stated] {
            assert!(message.contains(part), "{flag}: {message}");
        }
    }
    let f = playing_with(USABLE, &["--max-channels", "1"]).await;
    let many = RecordingSummary { channels: 1, ..ten_minutes() };
    assert!(refusal(&f, declared(&f, b"recording", many)).await.contains("states 2 schemas"));
    let many = RecordingSummary { channels: 1, schemas: 1, ..ten_minutes() };
    assert!(refusal(&f, declared(&f, b"recording", many)).await.contains("states 2 topics"));

    let f = playing(USABLE).await;
    let mut endless = ten_minutes();
    endless.topics.insert("/robot/state".into(), 10_000_001);
    assert!(refusal(&f, declared(&f, b"recording", endless)).await.contains("10000001 messages of /robot/state"));
    let mut unread = ten_minutes();
    unread.topics.insert("/imu".into(), 10_000_001);
    assert!(f.ingest.start(declared(&f, b"recording", unread)).await.is_ok(), "the task does not read that topic");
}

/// The task of the fixture with a camera of 480 × 640.
async fn with_camera(f: &Fixture) -> NewUpload {
    let mut spec = f.task.spec.clone();
    (spec.name, spec.mappings) = ("seen".into(), Vec::new());
    spec.cameras.push(CameraSpec { name: "front".into(), height: 480, width: 640, depth: false, recorded: None });
    spec.mappings.push(written_mapping(&spec));
    let mut summary = ten_minutes();
    summary.topics.insert(spec.mappings[0].cameras[0].color.clone(), 6000);
    let task = f.store.insert_task(&spec).await.unwrap();
    NewUpload { task_id: task.id, ..declared(f, b"recording", summary) }
}

/// 6000 pictures of 921,600 bytes take a 64th of that at least.
const LEAST: u64 = 6000 * 921_600 / 64;

#[tokio::test]
async fn declared_images_above_what_an_inspection_writes_are_rejected() {
    let f = playing_with(USABLE, &["--inspect-memory-bytes", "80000000"]).await;
    let message = refusal(&f, with_camera(&f).await).await;
    for part in [LEAST.to_string().as_str(), "may write 80000144", "--inspect-memory-bytes"] {
        assert!(message.contains(part), "{part}: {message}");
    }
}

/// Of a recording whose size is not declared, the largest that may be sent.
#[tokio::test]
async fn declared_images_of_a_recording_that_passes_are_compared_too() {
    let f = playing_with(USABLE, &["--inspect-memory-bytes", "80000000", "--max-upload-bytes", "1000"]).await;
    let new = with_camera(&f).await;
    let task = f.store.task_by_id(&new.task_id).await.unwrap().spec;
    for (size_bytes, most) in [(Some(9), "may write 80000144"), (None, "may write 80016000")] {
        let declared = Declared { size_bytes, summary: new.summary.clone(), ..Declared::default() };
        let chunks = futures::stream::pending();
        let error = f.ingest.pass(&Client::Server, &task, declared, chunks).await.unwrap_err();
        assert_eq!(error.kind(), Kind::Exhausted);
        for part in ["open.summary: ", LEAST.to_string().as_str(), most] {
            assert!(error.message().contains(part), "{part}: {error}");
        }
    }
}

#[tokio::test]
async fn an_upload_needs_room_for_its_decoded_steps_too() {
    let mut f = playing(USABLE).await;
    let free = f.on_a_small_disk();
    free.store(100 + 9 + LEAST - 1, Ordering::Relaxed);
    let new = with_camera(&f).await;
    let error = f.ingest.start(new.clone()).await.unwrap_err();
    assert!(error.kind() == Kind::Exhausted && error.message().contains("--min-free-bytes"), "{error}");
    free.store(100 + 9 + LEAST, Ordering::Relaxed);
    assert!(f.ingest.start(new).await.is_ok());
}

#[tokio::test]
async fn a_check_opens_no_upload_and_names_an_existing_episode() {
    let f = playing(USABLE).await;
    let (existing, estimate) = f.ingest.check(declared(&f, b"recording", ten_minutes())).await.unwrap();
    assert_eq!((existing.is_none(), estimate.map(|estimate| estimate.steps)), (true, Some(6000)));
    assert!(f.store.uploads().await.unwrap().is_empty() && f.files(&["uploads"]).is_empty());
    let stored = f.push(b"recording").await.unwrap().episode;
    let (existing, estimate) = f.ingest.check(f.new_upload(b"recording")).await.unwrap();
    assert_eq!((existing.map(|episode| episode.id), estimate), (Some(stored.id), None));
    let other = NewUpload { cohort: "bob".into(), ..f.new_upload(b"recording") };
    assert_eq!(f.ingest.check(other).await.unwrap_err().kind(), Kind::Exists);
}

/// A declaration within the limits does not exempt the recording from its inspection, and a right one is no obstacle.
#[tokio::test]
async fn the_inspection_decides_whatever_was_declared() {
    let f = real("none", &["--max-records", "30"]).await;
    let content = recording(&f.task, 20);
    let path = f.dir.path().join("a.mcap");
    std::fs::write(&path, &content).unwrap();
    let sound = summarize(&path).unwrap().unwrap();
    assert_eq!((sound.messages, sound.topics.len()), (40, 2));
    assert!(refusal(&f, declared(&f, &content, sound)).await.contains("--max-records"));
    for lie in [Some(RecordingSummary::default()), None] {
        let new = NewUpload { summary: lie, ..f.new_upload(&content) };
        let Started::Open(upload) = f.ingest.start(new).await.unwrap() else { panic!("no episode exists") };
        f.write(&upload.id, 0, &content).await.unwrap();
        let error = f.ingest.finish(&upload.id).await.unwrap_err();
        assert!(error.kind() == Kind::Invalid && error.message().contains("more than 30 records"), "{error}");
    }
    let f = real("none", &[]).await;
    let Started::Open(upload) = f.ingest.start(declared(&f, &content, RecordingSummary::default())).await.unwrap()
    else {
        panic!("no episode exists")
    };
    f.write(&upload.id, 0, &content).await.unwrap();
    assert_eq!(f.ingest.finish(&upload.id).await.unwrap().episode.steps, 20, "a wrong summary is no obstacle");
}
