//! Concurrent clients: how they share inspections, and the limit on open uploads.

use std::{collections::VecDeque, path::PathBuf, process::Command};

use tokio::task::JoinHandle;

use super::{super::testing::playing_with, *};
use crate::{
    domain::{
        client::Client,
        episode::{InspectedEpisode, NewUpload, Upload},
    },
    error::Result,
    store::testing::inspected,
};

type Finishing = JoinHandle<Result<InspectedEpisode>>;

/// Recordings that begin with "slow" wait until the test opens the gate, a FIFO beside the folder of uploads.
fn gated() -> String {
    format!(
        r#"uploads="${{recording%/*}}"; case $(cat "$recording") in slow*) : < "$uploads/../gate";; esac
        cat "$recording" >> "$uploads/../order"; {USABLE}"#
    )
}

struct Lab {
    fixture: Fixture,
    gate: PathBuf,
}

impl Lab {
    async fn new(flags: &[&str]) -> Self {
        let fixture = playing_with(&gated(), flags).await;
        let gate = fixture.dir.path().join("gate");
        assert!(Command::new("mkfifo").arg(&gate).status().unwrap().success());
        Self { fixture, gate }
    }

    /// An upload of the client's with all its bytes.
    async fn uploaded(&self, client: &Client, content: &str) -> Upload {
        let new = NewUpload { client: client.clone(), ..self.fixture.new_upload(content.as_bytes()) };
        let Started::Open(upload) = self.fixture.ingest.start(new).await.unwrap() else { panic!("{content}: stored") };
        self.fixture.write(&upload.id, 0, content.as_bytes()).await.unwrap();
        upload
    }

    async fn finishing(&self, client: &Client, content: &str) -> Finishing {
        let (ingest, id) = (self.fixture.ingest.clone(), self.uploaded(client, content).await.id);
        tokio::spawn(async move { ingest.finish(&id).await })
    }

    /// Waits until this many of the client's inspections are under way, and this many wait.
    async fn until(&self, client: &Client, running: usize, waiting: usize) {
        let deadline = Instant::now() + Duration::from_secs(60);
        let counted = || self.fixture.ingest.inspector.slots.count(client);
        while counted() != (running, waiting) {
            assert!(Instant::now() < deadline, "{:?} instead of {:?}", counted(), (running, waiting));
            tokio::task::yield_now().await;
        }
    }

    /// Releases the slow recordings: a FIFO open for writing blocks no reader.
    fn open_gate(&self) -> fs::File {
        fs::File::options().read(true).write(true).open(&self.gate).unwrap()
    }
}

fn token(name: &str) -> Client {
    Client::Token(name.into())
}

#[tokio::test]
async fn six_slow_recordings_of_one_client_do_not_delay_anothers_push() {
    let lab = Lab::new(&[]).await;
    let (hog, other) = (token("hog"), token("other"));
    let mut slow = Vec::new();
    for number in 1..=6 {
        slow.push(lab.finishing(&hog, &format!("slow {number};")).await);
    }
    // Of three slots by default, one client gets two.
    lab.until(&hog, 2, 4).await;
    lab.finishing(&other, "quick;").await.await.unwrap().unwrap();
    assert_eq!(lab.fixture.ingest.inspector.slots.count(&hog), (2, 4), "all six are under way still");
    assert!(slow.iter().all(|finishing| !finishing.is_finished()));

    let _open = lab.open_gate();
    for finishing in slow {
        finishing.await.unwrap().unwrap();
    }
}

#[tokio::test]
async fn with_one_slot_a_push_waits_for_one_inspection_of_another_client() {
    let lab = Lab::new(&["--inspect-parallel", "1"]).await;
    let (hog, other) = (token("hog"), token("other"));
    let mut finishing = VecDeque::new();
    for number in 1..=3 {
        finishing.push_back(lab.finishing(&hog, &format!("slow {number};")).await);
        lab.until(&hog, 1, number - 1).await;
    }
    finishing.push_back(lab.finishing(&other, "quick;").await);
    lab.until(&other, 0, 1).await;
    let _open = lab.open_gate();
    for finishing in finishing {
        finishing.await.unwrap().unwrap();
    }
    let order = fs::read_to_string(lab.fixture.dir.path().join("order")).unwrap();
    assert_eq!(order, "slow 1;quick;slow 2;slow 3;");
}

#[tokio::test]
async fn a_scored_recording_of_a_disconnected_client_frees_its_slot() {
    let lab = Lab::new(&["--inspect-parallel", "1"]).await;
    let (hog, gone) = (token("hog"), token("gone"));
    let slow = lab.finishing(&hog, "slow;").await;
    lab.until(&hog, 1, 0).await;
    let (ingest, spec, client) = (lab.fixture.ingest.clone(), lab.fixture.task.spec.clone(), gone.clone());
    let scored = tokio::spawn(async move {
        let content = stream::iter([Ok("quick;".into())]);
        ingest.pass(&client, &spec, super::super::Declared::default(), content).await.map(drop)
    });
    lab.until(&gone, 0, 1).await;
    scored.abort();
    assert!(scored.await.unwrap_err().is_cancelled());
    assert_eq!(lab.fixture.ingest.inspector.slots.count(&gone), (0, 0));
    let _open = lab.open_gate();
    slow.await.unwrap().unwrap();
}

#[tokio::test]
async fn open_uploads_of_a_client_have_a_limit_that_a_restart_keeps() {
    let mut lab = Lab::new(&["--max-open-uploads-per-caller", "2", "--keep-uploads-days", "3"]).await;
    let (one, other) = (token("one"), Client::Address([127, 0, 0, 1].into()));
    let f = &lab.fixture;
    let first = lab.uploaded(&one, "first").await;
    let new = |client: &Client, content: &[u8]| NewUpload { client: client.clone(), ..f.new_upload(content) };
    f.ingest.start(new(&one, b"second")).await.unwrap();
    let error = f.ingest.start(new(&one, b"third")).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Exhausted);
    for part in ["2 uploads of this caller", "--max-open-uploads-per-caller", "3 days", "--keep-uploads-days"] {
        assert!(error.message().contains(part), "{error}");
    }
    assert_eq!(f.files(&["uploads"]).len(), 2, "the refused upload left no file");
    f.ingest.start(new(&other, b"third")).await.unwrap();
    // The author is a client's own label and is not counted.
    let renamed = NewUpload { author: "another person".into(), ..new(&one, b"fourth") };
    assert_eq!(f.ingest.start(renamed).await.unwrap_err().kind(), Kind::Exhausted);

    lab.fixture.reopen().await;
    let f = &lab.fixture;
    let new = |client: &Client, content: &[u8]| NewUpload { client: client.clone(), ..f.new_upload(content) };
    assert_eq!(f.ingest.start(new(&one, b"third, too")).await.unwrap_err().kind(), Kind::Exhausted);
    let Started::Open(resumed) = f.ingest.start(new(&one, b"first")).await.unwrap() else { panic!("stored") };
    assert_eq!((&resumed.id, resumed.committed), (&first.id, 5), "open uploads can be resumed");
    for number in 0..3 {
        // Recordings of the server's own sessions have no limit.
        f.ingest.start(new(&Client::Server, format!("rollout {number}").as_bytes())).await.unwrap();
    }
    f.ingest.finish(&first.id).await.unwrap();
    f.ingest.start(new(&one, b"third, too")).await.unwrap();
}

#[tokio::test]
async fn concurrent_starts_do_not_pass_the_limit_together() {
    let lab = Lab::new(&["--max-open-uploads-per-caller", "3"]).await;
    let f = &lab.fixture;
    let starts = (0..12).map(|number| f.ingest.start(f.new_upload(format!("content {number}").as_bytes())));
    let open = futures::future::join_all(starts).await.into_iter().filter(Result::is_ok).count();
    assert_eq!((open, f.store.uploads().await.unwrap().len(), f.files(&["uploads"]).len()), (3, 3, 3));
}

#[tokio::test]
async fn a_limit_of_zero_allows_any_number_of_open_uploads() {
    let lab = Lab::new(&["--max-open-uploads-per-caller", "0"]).await;
    for number in 0..5 {
        lab.fixture.start(format!("content {number}").as_bytes()).await;
    }
}

/// The content becomes an episode of another label while it is inspected.
#[tokio::test]
async fn a_label_refused_after_the_inspection_leaves_no_sidecar() {
    let lab = Lab::new(&[]).await;
    let (f, bob) = (&lab.fixture, token("bob"));
    let finishing = lab.finishing(&bob, "slow;").await;
    lab.until(&bob, 1, 0).await;
    let first = Upload { id: UploadId::new(), cohort: "eve".into(), ..f.store.uploads().await.unwrap().remove(0) };
    let inspected = inspected(&f.task, &first);
    let blob = f.ingest.blobs.put(b"slow;").unwrap();
    f.ingest.describe(&f.task, &inspected, "tests").await.unwrap();
    f.store.finish_upload(&first, &inspected).await.unwrap();

    let _open = lab.open_gate();
    assert_eq!(finishing.await.unwrap().unwrap_err().kind(), Kind::Exists);
    assert_eq!(f.ingest.blobs.descriptions(&blob).unwrap().len(), 1);
    assert!(f.ingest.blobs.is_described(&blob, inspected.episode.id.as_str()));
}
