//! Copies in a folder of one machine.

use super::*;

/// The names of copies in a folder of one machine, in order; drafts are among them.
fn copies(near: &Path) -> Vec<PathBuf> {
    let mut found = names(&near.join("cache")).unwrap();
    found.sort();
    found
}

#[test]
fn copies_are_in_the_folder_of_the_machine_by_url_and_by_the_server() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let (bench, near) = (Bench::new(&store), tempfile::tempdir().unwrap());
    let worker = bench.worker.clone().caching_in(Some(near.path())).unwrap();
    let id = worker.put(b"steps").unwrap();
    bench.forget(&id);
    let copy = near.path().join(format!("cache/{id}.copy"));
    for (answer, of_server) in [(Answer::Signed, false), (Answer::Copy, true)] {
        bench.answers(&[answer]);
        assert_eq!(worker.get(&id).unwrap(), b"steps");
        assert_eq!(copies(near.path()), std::slice::from_ref(&copy));
        assert_eq!(worker.path(&id).exists(), of_server, "{answer:?}");
        // It is there: nothing is called.
        bench.accepted();
        assert_eq!(fs::read(worker.fetched(&id).unwrap()).unwrap(), b"steps");
        assert!(bench.accepted().is_empty());
        // A damaged one is replaced.
        fs::write(&copy, b"stepz").unwrap();
        assert_eq!(worker.get(&id).unwrap(), b"steps");
        fs::remove_file(&copy).unwrap();
    }
}

#[test]
fn a_damaged_copy_of_the_server_is_not_copied() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let (bench, near) = (Bench::new(&store), tempfile::tempdir().unwrap());
    let worker = bench.worker.clone().caching_in(Some(near.path())).unwrap();
    let id = worker.put(b"steps").unwrap();
    fs::write(worker.path(&id), b"stepz").unwrap();
    let error = worker.copy_near(&id, &worker.path(&id), &worker.copy_path(&id)).unwrap_err();
    assert!(error.kind() == Kind::Damaged && error.message().contains("--data-dir"), "{error}");
    assert!(copies(near.path()).is_empty());
}

#[test]
fn copies_are_limited_and_the_least_recently_used_goes_first() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let (bench, near) = (Bench::new(&store), tempfile::tempdir().unwrap());
    let worker = bench.worker.clone().caching_in(Some(near.path())).unwrap().limiting_caches(Some(12)).unwrap();
    let ids: Vec<_> = [&b"first"[..], b"second", b"third"].map(|content| worker.put(content).unwrap()).into();
    for id in &ids {
        assert!(worker.fetched(id).unwrap().is_file());
    }
    let left: Vec<_> = ids.iter().map(|id| worker.copy_path(id).exists()).collect();
    assert_eq!(left, [false, true, true]);
}

#[test]
fn drafts_of_killed_processes_are_removed_at_the_next_opening() {
    let near = tempfile::tempdir().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let open = || Blobs::open(dir.path()).unwrap().caching_in(Some(near.path())).unwrap();
    open();
    let (young, other) = (near.path().join("cache/.draft-young"), near.path().join("cache/other"));
    fs::write(&young, b"st").unwrap();
    fs::write(&other, b"st").unwrap();
    open();
    assert_eq!(copies(near.path()), [young, other], "the young one may be in use");
}
