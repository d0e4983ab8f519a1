//! Servers whose blobs are in a bucket.

use std::{fs, io::ErrorKind, path::Path};

use gleaner_bucket::testing::TestStore;

use super::{files, server::TestServer};

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
    for file in files::blobs(data) {
        match fs::remove_file(file) {
            // The server has removed what an ended job needs no more.
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            removed => removed.unwrap(),
        }
    }
    fs::remove_dir_all(data.join("cache")).unwrap();
    fs::create_dir(data.join("cache")).unwrap();
}

/// The number of copies of blobs in a data folder.
pub fn copies(data: &Path) -> usize {
    files::blobs(data).len()
}
