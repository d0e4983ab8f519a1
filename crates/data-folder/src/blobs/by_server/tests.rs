//! A process without credentials and its server, on one data folder and one bucket.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use gleaner_bucket::testing::TestStore;
use tempfile::TempDir;

use super::*;
use crate::blobs::{BlobServer, remote};

mod node;

/// The answer of a server to a call for content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Answer {
    /// A URL of the object.
    Signed,
    /// A URL at which there is no store.
    Dead,
    /// No URL: the copy is fetched.
    Copy,
}

/// A server whose answers a test chooses.
#[derive(Debug)]
struct Server {
    blobs: Blobs,
    /// The next answers; [`Answer::Signed`] after them.
    answers: Mutex<VecDeque<Answer>>,
    /// Whether each call for content accepted a URL.
    accepted: Mutex<Vec<bool>>,
    /// The error of the next calls that store.
    refusal: Mutex<Option<Error>>,
}

fn of<T>(value: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

impl BlobServer for Server {
    fn locate(&self, id: &BlobId, want: Want) -> Result<Option<Located>> {
        let Want::Content { accept_url } = want else {
            return Ok(self.blobs.size(id)?.map(|size_bytes| Located { size_bytes, url: None }));
        };
        of(&self.accepted).push(accept_url);
        let Some(size_bytes) = self.blobs.make_copy_room(id)? else { return Ok(None) };
        let answer = of(&self.answers).pop_front().unwrap_or(Answer::Signed);
        let url = match answer {
            Answer::Signed if accept_url => {
                let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
                runtime.block_on(self.blobs.signed_url(id, Some(Duration::from_secs(60))))
            }
            Answer::Dead if accept_url => Some("http://127.0.0.1:1/?X-Amz-Signature=x".to_owned().into()),
            Answer::Signed | Answer::Dead | Answer::Copy => None,
        };
        if url.is_none() {
            self.blobs.keep_copy(id)?;
        }
        Ok(Some(Located { size_bytes, url }))
    }

    fn store(&self, id: &BlobId) -> Result<()> {
        of(&self.refusal).take().map_or_else(|| self.blobs.take(id), Err)
    }
}

struct Bench {
    dir: TempDir,
    server: Arc<Server>,
    worker: Blobs,
}

impl Bench {
    /// Both on a new folder.
    fn new(store: &TestStore) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let plain = Blobs::open(dir.path()).unwrap();
        let owned = Remote::new(store.bucket("one").unwrap(), 0);
        let server = Arc::new(Server {
            blobs: Blobs { remote: Some(Arc::new(owned)), ..plain.clone() },
            answers: Mutex::default(),
            accepted: Mutex::default(),
            refusal: Mutex::default(),
        });
        let by = Remote::by(Arc::clone(&server) as _);
        Self { dir, worker: Blobs { remote: Some(Arc::new(by)), ..plain }, server }
    }

    fn forget(&self, id: &BlobId) {
        fs::remove_file(self.worker.path(id)).unwrap();
    }

    fn answers(&self, answers: &[Answer]) {
        of(&self.server.answers).extend(answers);
    }

    /// Whether the calls for content since the last one accepted a URL.
    fn accepted(&self) -> Vec<bool> {
        std::mem::take(&mut of(&self.server.accepted))
    }

    /// The files in `tmp`, and the drafts beside a blob.
    fn leavings(&self, id: &BlobId) -> Vec<PathBuf> {
        let beside = names(self.worker.path(id).parent().unwrap()).unwrap();
        let drafts = beside.into_iter().filter(|path| *path != self.worker.path(id));
        names(&self.dir.path().join("tmp")).unwrap().into_iter().chain(drafts).collect()
    }
}

#[test]
fn a_process_without_credentials_stores_by_its_server_and_reads_at_urls() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let bench = Bench::new(&store);
    let large: Vec<u8> = (0..=250).cycle().take((9 << 20) + 7).collect();
    let (small, empty, file) =
        (bench.worker.put(b"steps").unwrap(), bench.worker.put(b"").unwrap(), bench.dir.path().join("tmp/made"));
    fs::write(&file, &large).unwrap();
    let large_id = bench.worker.put_file(&file).unwrap();
    for (id, content) in [(&small, &b"steps"[..]), (&empty, &[]), (&large_id, &large)] {
        assert_eq!(&bench.server.blobs.digest(id).unwrap(), id, "it is in the bucket");
        assert!(bench.worker.path(id).is_file() && bench.leavings(id).is_empty());
        assert_eq!(bench.worker.size(id).unwrap(), Some(content.len() as u64));
        bench.forget(id);
        assert!(bench.worker.get(id).unwrap() == content);
        assert_eq!(bench.accepted(), [true], "one URL, and no copy of the server");
        assert!(bench.worker.fetched(id).unwrap().is_file());
        assert!(bench.leavings(id).is_empty());
    }
    // The server keeps what is there, and repeats what is not.
    bench.worker.put(b"steps").unwrap();
    assert_eq!(bench.worker.get(&small).unwrap(), b"steps");
    let gone = BlobId::from(blake3::hash(b"gone"));
    assert!(bench.worker.size(&gone).unwrap().is_none() && !bench.worker.contains(&gone));
    let error = bench.worker.get(&gone).unwrap_err();
    assert!(error.kind() == Kind::Damaged && error.message().contains("--blob-store"), "{error}");
}

#[test]
fn without_a_url_the_copy_is_that_of_the_server() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let bench = Bench::new(&store);
    let id = bench.worker.put(b"steps").unwrap();
    bench.forget(&id);
    bench.answers(&[Answer::Copy]);
    assert_eq!(bench.worker.get(&id).unwrap(), b"steps");
    // A damaged copy is replaced, by either way.
    for answer in [Answer::Copy, Answer::Signed] {
        fs::write(bench.worker.path(&id), b"stepz").unwrap();
        bench.answers(&[answer]);
        bench.accepted();
        assert_eq!(bench.worker.get(&id).unwrap(), b"steps");
        assert_eq!(bench.accepted(), [true]);
    }
    fs::write(bench.worker.path(&id), b"stepz").unwrap();
    assert!(bench.worker.drop_damaged_copy(&id).unwrap() && !bench.worker.path(&id).exists());
    assert!(!bench.worker.drop_damaged_copy(&bench.worker.put(b"sound").unwrap()).unwrap());
}

#[test]
fn a_url_that_fails_is_replaced_once_and_then_the_server_reads() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let bench = Bench::new(&store);
    let id = bench.worker.put(b"steps").unwrap();
    let read = |answers: &[Answer]| {
        bench.forget(&id);
        bench.answers(answers);
        assert_eq!(bench.worker.get(&id).unwrap(), b"steps");
        assert!(bench.leavings(&id).is_empty());
        bench.accepted()
    };
    assert_eq!(read(&[Answer::Dead]), [true, true], "the second URL is good");
    assert_eq!(read(&[Answer::Dead, Answer::Dead]), [true, true, false]);
    assert_eq!(read(&[]), [false], "for a while no URL is requested");
}

#[test]
fn an_altered_object_is_an_error_and_leaves_no_file() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let bench = Bench::new(&store);
    let id = bench.worker.put(b"steps").unwrap();
    bench.forget(&id);
    let altered = bench.dir.path().join("altered");
    let bucket = store.bucket("one").unwrap();
    for content in [&b"stepz"[..], b"step", b"steps and more"] {
        fs::write(&altered, content).unwrap();
        bucket.put(&remote::name(bench.dir.path(), &bench.worker.path(&id)), &altered).unwrap();
        let error = bench.worker.fetched(&id).unwrap_err();
        assert!(error.to_string().contains("damaged"), "{error}");
        assert_eq!(bench.accepted(), [true, true, false]);
        assert!(!bench.worker.path(&id).exists() && bench.leavings(&id).is_empty());
    }
    // Storing the content again repairs the object.
    bench.worker.put(b"steps").unwrap();
    assert_eq!(bench.server.blobs.digest(&id).unwrap(), id);
}

#[test]
fn only_a_file_with_the_digest_of_its_name_is_stored() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let bench = Bench::new(&store);
    let (server, id) = (&bench.server.blobs, BlobId::from(blake3::hash(b"steps")));
    let handed = server.handed(&id);
    assert_eq!(server.take(&id).unwrap_err().kind(), Kind::NotFound);
    fs::write(&handed, b"stepz").unwrap();
    let error = server.take(&id).unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("digest"), "{error}");
    fs::remove_file(&handed).unwrap();
    let elsewhere = bench.dir.path().join("elsewhere");
    fs::write(&elsewhere, b"steps").unwrap();
    std::os::unix::fs::symlink(&elsewhere, &handed).unwrap();
    let error = server.take(&id).unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("not a file"), "{error}");
    fs::remove_file(&handed).unwrap();
    assert!(!server.contains(&id) && elsewhere.is_file());
    fs::rename(&elsewhere, &handed).unwrap();
    server.take(&id).unwrap();
    assert!(server.path(&id).is_file() && !handed.exists());
    server.take(&id).unwrap();
    assert_eq!(server.digest(&id).unwrap(), id);
}

#[test]
fn a_file_that_the_server_does_not_store_stays_where_it_is() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let bench = Bench::new(&store);
    let file = bench.dir.path().join("tmp/made");
    fs::write(&file, b"steps").unwrap();
    let refuse = |error| *of(&bench.server.refusal) = Some(error);
    refuse(Error::unavailable("no store"));
    assert_eq!(bench.worker.put_file(&file).unwrap_err().kind(), Kind::Unavailable);
    let id = BlobId::from(blake3::hash(b"steps"));
    assert!(file.is_file() && !bench.server.blobs.handed(&id).exists() && !bench.worker.path(&id).exists());
    refuse(Error::unavailable("no store"));
    assert!(bench.worker.put(b"steps").is_err());
    assert_eq!(names(&bench.dir.path().join("tmp")).unwrap(), std::slice::from_ref(&file));
    // Another process has handed over the same content, and has removed the file when its call failed.
    refuse(Error::not_found("blob", &id));
    assert_eq!(bench.worker.put_file(&file).unwrap(), id);
    assert!(!file.exists() && bench.server.blobs.contains(&id));
}

#[test]
fn what_only_the_server_does_is_an_error_of_other_processes() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let bench = Bench::new(&store);
    let id = bench.worker.put(b"steps").unwrap();
    let errors = [
        bench.worker.list().map(drop),
        bench.worker.digest(&id).map(drop),
        bench.worker.placed(&id).map(drop),
        bench.worker.list_trash().map(drop),
    ];
    for error in errors {
        assert!(error.unwrap_err().to_string().contains("credentials"));
    }
    assert!(!bench.worker.resend(&id).unwrap());
}

#[test]
fn a_folder_without_a_bucket_needs_no_server() {
    let dir = tempfile::tempdir().unwrap();
    let plain = Blobs::open(dir.path()).unwrap();
    let server = Server {
        blobs: plain.clone(),
        answers: Mutex::default(),
        accepted: Mutex::default(),
        refusal: Mutex::new(Some(Error::unavailable("not called"))),
    };
    let worker = Blobs::open_by(dir.path(), Arc::new(server)).unwrap();
    let id = worker.put(b"steps").unwrap();
    assert_eq!((worker.get(&id).unwrap(), worker.size(&id).unwrap()), (b"steps".to_vec(), Some(5)));
    assert_eq!(worker.list().unwrap().len(), 1);
    // A server whose folder holds the blobs answers too.
    fs::write(plain.handed(&id), b"steps").unwrap();
    plain.take(&id).unwrap();
    plain.keep_copy(&id).unwrap();
    assert_eq!(plain.make_copy_room(&id).unwrap(), Some(5));
}
