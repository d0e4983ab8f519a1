//! Servers whose blobs are in a bucket.

use std::{
    fs,
    path::{Path, PathBuf},
};

use gleaner_bucket::testing::TestStore;

use super::server::TestServer;

/// The flags of a bucket.
pub fn flags(store: &TestStore, prefix: &str) -> Vec<String> {
    let config = store.config(prefix);
    ["--blob-store", &config.url, "--blob-store-endpoint", &config.endpoint.unwrap(), "--blob-store-http"]
        .map(str::to_owned)
        .into()
}

/// A server with a bucket, and with more flags.
pub async fn start(store: &TestStore, prefix: &str, more: &[&str]) -> TestServer {
    let flags = flags(store, prefix);
    TestServer::start_with(&[&flags.iter().map(String::as_str).collect::<Vec<_>>(), more].concat()).await
}

/// Removes the copies of blobs, and the decoded steps, from a data folder.
pub fn forget_copies(data: &Path) {
    for file in copy_paths(data) {
        fs::remove_file(file).unwrap();
    }
    fs::remove_dir_all(data.join("cache")).unwrap();
    fs::create_dir(data.join("cache")).unwrap();
}

/// The number of copies of blobs in a data folder.
pub fn copies(data: &Path) -> usize {
    copy_paths(data).len()
}

/// The copies of blobs in a data folder, without their sidecars and what a running server is about to rename.
fn copy_paths(data: &Path) -> Vec<PathBuf> {
    let folders = fs::read_dir(data.join("blobs")).unwrap().map(|entry| entry.unwrap());
    let folders = folders.filter(|folder| folder.file_name().len() == 2);
    let files = folders.flat_map(|folder| fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()));
    let is_draft =
        |file: &PathBuf| file.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b".draft-"));
    files.filter(|file| file.extension().is_none() && !is_draft(file)).collect()
}
