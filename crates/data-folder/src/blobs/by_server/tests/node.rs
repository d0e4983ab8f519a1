//! Copies in a node folder.

use super::*;

/// The paths in a node folder, in order; drafts are among them.
fn copies(node: &Path) -> Vec<PathBuf> {
    let mut found = names(&node.join("cache")).unwrap();
    found.sort();
    found
}

#[test]
fn copies_are_in_the_node_folder_by_url_and_by_the_server() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let (bench, node) = (Bench::new(&store), tempfile::tempdir().unwrap());
    let worker = bench.worker.caching_in(node.path()).unwrap();
    let id = worker.put(b"steps").unwrap();
    bench.forget(&id);
    let copy = node.path().join(format!("cache/{id}.copy"));
    for (answer, of_server) in [(Answer::Signed, false), (Answer::Copy, true)] {
        bench.answers(&[answer]);
        assert_eq!(worker.get(&id).unwrap(), b"steps");
        assert_eq!(copies(node.path()), std::slice::from_ref(&copy));
        assert_eq!(worker.path(&id).exists(), of_server, "{answer:?}");
        // It is found without a call.
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
    let (bench, node) = (Bench::new(&store), tempfile::tempdir().unwrap());
    let worker = bench.worker.caching_in(node.path()).unwrap();
    let id = worker.put(b"steps").unwrap();
    fs::write(worker.path(&id), b"stepz").unwrap();
    let error = worker.copy_to_node(&id, &worker.path(&id), &worker.copy_path(&id)).unwrap_err();
    assert!(error.kind() == Kind::Damaged && error.message().contains("--data-dir"), "{error}");
    assert!(copies(node.path()).is_empty());
}

#[test]
fn copies_are_limited_and_the_least_recently_used_goes_first() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let (bench, node) = (Bench::new(&store), tempfile::tempdir().unwrap());
    let worker = bench.worker.caching_in(node.path()).unwrap().limiting_caches(Some(12)).unwrap();
    let ids: Vec<_> = [&b"first"[..], b"second", b"third"].map(|content| worker.put(content).unwrap()).into();
    for id in &ids {
        assert!(worker.fetched(id).unwrap().is_file());
    }
    let left: Vec<_> = ids.iter().map(|id| worker.copy_path(id).exists()).collect();
    assert_eq!(left, [false, true, true]);
}

#[test]
fn a_file_in_use_outlives_its_copy_and_another_process_finds_the_copy() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let (bench, node) = (Bench::new(&store), tempfile::tempdir().unwrap());
    let open = || bench.worker.caching_in(node.path()).unwrap().limiting_caches(Some(8)).unwrap();
    let (one, other) = (open(), open());
    let (first, second) = (one.put(b"first").unwrap(), one.put(b"second").unwrap());
    let held = one.fetched(&first).unwrap();
    bench.accepted();
    assert_eq!(other.get(&first).unwrap(), b"first");
    assert!(bench.accepted().is_empty(), "the copy of the other process");
    assert_eq!(one.get(&second).unwrap(), b"second");
    assert!(!one.copy_path(&first).exists() && fs::read(&held).unwrap() == b"first");
    assert_eq!(other.get(&first).unwrap(), b"first", "it is fetched again");
}

#[test]
fn without_room_in_the_node_folder_copies_are_in_the_data_folder() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let (bench, node) = (Bench::new(&store), tempfile::tempdir().unwrap());
    let worker = bench.worker.caching_in(node.path()).unwrap();
    let id = worker.put(b"steps").unwrap();
    bench.forget(&id);
    let mut full = worker.clone();
    full.node = full.node.map(|space| space.with_reserve(u64::MAX));
    assert_eq!(full.get(&id).unwrap(), b"steps");
    assert!(copies(node.path()).is_empty() && worker.path(&id).exists());
}

#[test]
fn drafts_of_killed_processes_are_removed_after_a_day() {
    let (node, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let open = || Blobs::open(dir.path()).unwrap().caching_in(node.path()).unwrap();
    open();
    let cache = node.path().join("cache");
    let (draft, other) = (cache.join(".draft-young"), cache.join("other"));
    fs::write(&draft, b"st").unwrap();
    fs::write(&other, b"st").unwrap();
    open();
    assert_eq!(copies(node.path()), [draft, other.clone()], "a young one may be in use");
    crate::blobs::list::remove_drafts(&cache, std::time::SystemTime::now() + Duration::from_secs(24 * 60 * 60))
        .unwrap();
    assert_eq!(copies(node.path()), [other]);
}

#[test]
fn a_folder_to_which_others_may_write_is_rejected() {
    let (node, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let open = || Blobs::open(dir.path()).unwrap().caching_in(node.path());
    open().unwrap();
    let cache = node.path().join("cache");
    fs::set_permissions(&cache, std::os::unix::fs::PermissionsExt::from_mode(0o777)).unwrap();
    let error = open().unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("other users may write"), "{error}");
}
