//! A store that denies access, has no such bucket, is full, hangs, is away, or serves truncated or altered objects: each is
//! an error that names the setting. A server with canned answers plays it, because doubles of S3 check no signatures.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    io::{Read as _, Write as _},
    net::TcpListener,
    path::PathBuf,
    thread,
};

use gleaner_bucket::{Bucket, BucketConfig};
use gleaner_core::{
    Secret,
    error::{Error, Kind},
    id::BlobId,
};

fn config(endpoint: String) -> BucketConfig {
    BucketConfig {
        url: "s3://lab/robots".to_owned(),
        endpoint: Some(endpoint),
        region: None,
        http: true,
        virtual_host: false,
        timeout_seconds: 1,
    }
}

fn open(endpoint: String) -> Bucket {
    Bucket::open_with_key(&config(endpoint), ("id", &Secret::from("secret-of-the-key".to_owned()))).unwrap()
}

/// A store that gives one answer to HEAD and another to every other request. `None`: it never answers.
fn store(head: Option<String>, other: Option<String>) -> Bucket {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("http://{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        let mut held = Vec::new();
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let mut asked = vec![0; 64 << 10];
            let read = stream.read(&mut asked).unwrap_or(0);
            let answer = if asked[..read].starts_with(b"HEAD") { &head } else { &other };
            match answer {
                Some(answer) => {
                    let _ = stream.write_all(answer.as_bytes());
                }
                None => held.push(stream),
            }
        }
    });
    open(endpoint)
}

fn answer(status: &str, body: &str) -> Option<String> {
    Some(format!("HTTP/1.1 {status}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}", body.len()))
}

fn object(status: &str, size: usize, range: &str, body: &str) -> Option<String> {
    Some(format!(
        "HTTP/1.1 {status}\r\nContent-Length: {size}\r\n{range}ETag: \"e\"\r\nLast-Modified: Wed, 21 Oct 2015 07:28:00 \
         GMT\r\nConnection: close\r\n\r\n{body}"
    ))
}

fn file() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("file");
    std::fs::write(&path, b"steps").unwrap();
    (dir, path)
}

/// The error of a put names the setting, and neither the secret nor the id of the key.
fn put_fails(bucket: &Bucket, reason: &str) {
    let (_dir, path) = file();
    let error = bucket.put("blobs/ab/cd", &path).unwrap_err();
    assert_eq!(error.kind(), Kind::Unavailable, "{error}");
    assert!(error.message().contains(reason) && !error.to_string().contains("secret-of-the-key"), "{error}");
}

#[test]
fn denied_access_names_the_credentials() {
    let denied = || answer("403 Forbidden", "<Error><Code>SignatureDoesNotMatch</Code></Error>");
    put_fails(&store(denied(), denied()), "AWS_SECRET_ACCESS_KEY");
}

#[test]
fn a_missing_bucket_names_the_flag() {
    let missing = || answer("404 Not Found", "<Error><Code>NoSuchBucket</Code></Error>");
    put_fails(&store(missing(), missing()), "fix --blob-store");
}

#[test]
fn a_full_store_is_an_error_that_names_its_space() {
    let full = || answer("507 Insufficient Storage", "<Error><Code>StorageFull</Code></Error>");
    put_fails(&store(full(), full()), "free space");
}

#[test]
fn a_store_that_hangs_is_given_up_after_its_time() {
    let begun = std::time::Instant::now();
    put_fails(&store(None, None), "--blob-store-endpoint");
    assert!(begun.elapsed().as_secs() < 60);
}

#[test]
fn a_store_that_is_away_names_the_endpoint() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    drop(listener);
    put_fails(&open(format!("http://{address}")), "--blob-store-endpoint");
}

fn fetch(body: &str, size: usize) -> Error {
    let range = format!("Content-Range: bytes 0-{}/{size}\r\n", size - 1);
    let bucket = store(object("200 OK", size, "", ""), object("206 Partial Content", size, &range, body));
    let (_dir, path) = file();
    let to = std::fs::File::create(path).unwrap();
    bucket.fetch("blobs/ab/cd", &BlobId::from(blake3::hash(b"steps")), &to).unwrap_err()
}

#[test]
fn an_altered_object_is_an_error() {
    let error = fetch("stepz", 5);
    assert!(error.kind() == Kind::Internal && error.to_string().contains("damaged"), "{error}");
}

#[test]
fn a_truncated_object_is_an_error() {
    let error = fetch("ste", 5);
    assert!(matches!(error.kind(), Kind::Internal | Kind::Unavailable), "{error}");
}

#[test]
fn an_endpoint_without_tls_needs_a_flag() {
    let config = BucketConfig { http: false, ..config("http://127.0.0.1:1".to_owned()) };
    let error = Bucket::open_with_key(&config, ("id", &Secret::from("secret".to_owned()))).unwrap_err();
    assert!(error.message().contains("--blob-store-http"), "{error}");
}
