//! An upload compared with a model: for any order of client actions and server deaths, the committed size is the
//! model's and the bytes are the content's.

use futures::stream;
use proptest::{
    prelude::{Just, ProptestConfig, Strategy, prop, prop_oneof},
    test_runner::TestRunner,
};

use super::super::{
    Chunk, Started,
    testing::{Fixture, USABLE, chunk, playing},
};
use crate::{
    domain::{episode::Upload, id::UploadId},
    error::{Error, Kind},
};

/// An event of an upload.
#[derive(Debug, Clone)]
enum Event {
    /// A stream from this offset relative to the committed size, of messages of these lengths, that ends properly or
    /// breaks.
    Write { beside: i64, lengths: Vec<usize>, broken: bool },
    /// Another client starts the same content.
    Start,
    /// The server dies with this many uncommitted bytes in the part, and restarts.
    Die { unsynced: usize },
    /// The client finishes the upload.
    Finish,
}

fn event() -> impl Strategy<Value = Event> {
    let lengths = prop::collection::vec(0..14_usize, 0..4);
    // Mostly at the committed size.
    let beside = prop_oneof![8 => Just(0), 1 => -30..0_i64, 1 => 1..30_i64];
    prop_oneof![
        6 => (beside, lengths, prop::bool::ANY).prop_map(|(beside, lengths, broken)| Event::Write { beside, lengths, broken }),
        1 => Just(Event::Start),
        2 => (0..20_usize).prop_map(|unsynced| Event::Die { unsynced }),
        1 => Just(Event::Finish),
    ]
}

/// The declared content.
const CONTENT: &[u8] = b"what a robot saw and did while it picked a cube up";

/// The model: this many bytes are committed, or the episode exists.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Model {
    Open(usize),
    Episode,
}

/// Sends messages from `at` on. Messages beyond the content are padded, so that it is too long but never different.
fn messages(id: &UploadId, mut at: usize, lengths: &[usize]) -> Vec<Chunk> {
    let message = |length: &usize| {
        let from = at;
        at += length;
        let bytes: Vec<u8> = (from..at).map(|at| CONTENT.get(at).copied().unwrap_or(b'.')).collect();
        chunk(id, from, &bytes)
    };
    lengths.iter().map(message).collect()
}

/// The committed size after a stream of these messages on an upload with `before` committed bytes, and whether it is
/// refused.
fn expected(before: usize, at: usize, lengths: &[usize]) -> (usize, bool) {
    let mut end = before;
    for (place, length) in lengths.iter().enumerate() {
        if place == 0 && at != before || end + length > CONTENT.len() {
            return (end, true);
        }
        end += length;
    }
    (end, lengths.is_empty())
}

async fn write(f: &Fixture, id: &UploadId, model: Model, event: (i64, &[usize], bool)) -> Model {
    let (beside, lengths, broken) = event;
    let before = if let Model::Open(before) = model { before } else { 0 };
    let at = before.saturating_add_signed(isize::try_from(beside).unwrap());
    let chunks = messages(id, at, lengths);
    let broke = broken.then(|| Err(Error::cancelled("the connection broke")));
    let result = f.ingest.write(stream::iter(chunks.into_iter().map(Ok).chain(broke))).await;
    let Model::Open(before) = model else {
        let kind = result.unwrap_err().kind();
        // A stream that breaks, or ends, before its first message names no upload.
        assert!(matches!(kind, Kind::NotFound) || lengths.is_empty(), "{kind:?}");
        return model;
    };
    let (end, refused) = expected(before, at, lengths);
    match (refused, broken) {
        (true, true) if lengths.is_empty() => assert_eq!(result.unwrap_err().kind(), Kind::Cancelled),
        (true, _) => assert_eq!(result.unwrap_err().kind(), Kind::Invalid),
        (false, true) => assert_eq!(result.unwrap_err().kind(), Kind::Cancelled),
        (false, false) => assert_eq!(result.unwrap(), end as u64),
    }
    Model::Open(end)
}

/// The server's data as after a kill: with written and unacknowledged bytes.
async fn die(f: &mut Fixture, id: &UploadId, model: Model, unsynced: usize) {
    if let Model::Open(_) = model {
        let path = f.ingest.part_path(id);
        let mut part = std::fs::read(&path).unwrap();
        part.extend(std::iter::repeat_n(b'?', unsynced));
        std::fs::write(&path, part).unwrap();
    }
    f.reopen().await;
}

async fn finish(f: &Fixture, id: &UploadId, model: Model) -> Model {
    let result = f.ingest.finish(id).await;
    match model {
        Model::Open(committed) if committed == CONTENT.len() => {
            assert_eq!(result.unwrap().episode.size_bytes, CONTENT.len() as u64);
            Model::Episode
        }
        Model::Open(_) => {
            assert_eq!(result.unwrap_err().kind(), Kind::Precondition);
            model
        }
        Model::Episode => {
            assert_eq!(result.unwrap_err().kind(), Kind::NotFound);
            model
        }
    }
}

async fn start(f: &Fixture) -> Option<Upload> {
    match f.ingest.start(f.new_upload(CONTENT)).await.unwrap() {
        Started::Open(upload) => Some(upload),
        Started::Existing(_) => None,
    }
}

async fn play(events: Vec<Event>) {
    let mut f = playing(USABLE).await;
    let id = start(&f).await.unwrap().id;
    // As after its first message: then the upload is promised to this client.
    assert_eq!(f.write(&id, 0, b"").await.unwrap(), 0);
    let mut model = Model::Open(0);
    for event in events {
        match event {
            Event::Write { beside, lengths, broken } => model = write(&f, &id, model, (beside, &lengths, broken)).await,
            Event::Start => {
                let found = start(&f).await;
                let expected = if let Model::Open(committed) = model { Some(committed as u64) } else { None };
                assert_eq!(found.as_ref().map(|upload| upload.committed), expected);
                assert!(found.is_none_or(|upload| upload.id == id));
                let _ = f.write(&id, CONTENT.len(), b"").await;
            }
            Event::Die { unsynced } => die(&mut f, &id, model, unsynced).await,
            Event::Finish => model = finish(&f, &id, model).await,
        }
        check(&f, &id, model).await;
    }
}

/// The server agrees with the model, and the bytes are the content's.
async fn check(f: &Fixture, id: &UploadId, model: Model) {
    let status = f.ingest.status(id).await;
    match model {
        Model::Open(committed) => {
            assert_eq!(status.unwrap().committed, committed as u64);
            let part = std::fs::read(f.ingest.part_path(id)).unwrap();
            assert_eq!(part.get(..committed), CONTENT.get(..committed));
        }
        Model::Episode => {
            assert_eq!(status.unwrap_err().kind(), Kind::NotFound);
            assert_eq!(f.ingest.blobs.get(&blake3::hash(CONTENT).into()).unwrap(), CONTENT);
        }
    }
}

#[test]
fn an_upload_agrees_with_its_model() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let config = ProptestConfig { cases: 32, failure_persistence: None, ..ProptestConfig::default() };
    let mut runner = TestRunner::new_with_rng(
        config,
        proptest::test_runner::TestRng::deterministic_rng(proptest::test_runner::RngAlgorithm::ChaCha),
    );
    let events = prop::collection::vec(event(), 1..14);
    runner
        .run(&events, |events| {
            runtime.block_on(play(events));
            Ok(())
        })
        .unwrap();
}
