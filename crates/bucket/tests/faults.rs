//! A store that denies access or writes, has no such bucket, is full, is slow, hangs, is away, has another clock, or serves
//! truncated or altered objects: each is an error that names the setting. A server with canned answers plays it, because
//! doubles of S3 check no signatures.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{TcpListener, TcpStream},
    path::PathBuf,
    thread,
    time::{Duration, Instant},
};

use gleaner_bucket::{Bucket, BucketConfig};
use gleaner_core::{
    Secret,
    error::{Error, Kind},
    id::BlobId,
};

const NAME: &str = "blobs/ab/cd";
/// The time between two bytes of a slow store, a tenth of its timeout.
const TRICKLE: Duration = Duration::from_millis(200);

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

fn open(config: &BucketConfig) -> Bucket {
    Bucket::open_with_key(config, ("id", &Secret::from("secret-of-the-key".to_owned()))).unwrap()
}

#[derive(Clone)]
enum Answer {
    Whole(String),
    /// A beginning at once, and the rest byte by byte.
    Slow(String, String),
    /// This beginning, and no more.
    Hangs(String),
}

/// Answers each request by its method, and returns the endpoint.
fn serve(answer: impl Fn(&str) -> Answer + Send + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("http://{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        let mut held = Vec::new();
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            // A client that has gone is not an error of the store.
            let Some(method) = method(&stream) else { continue };
            let _ = match answer(&method) {
                Answer::Whole(text) => stream.write_all(text.as_bytes()),
                Answer::Slow(begin, rest) => stream.write_all(begin.as_bytes()).and_then(|()| {
                    rest.bytes().try_for_each(|byte| {
                        thread::park_timeout(TRICKLE);
                        stream.write_all(&[byte])
                    })
                }),
                Answer::Hangs(begin) => {
                    let written = stream.write_all(begin.as_bytes());
                    held.push(stream);
                    written
                }
            };
        }
    });
    endpoint
}

/// Reads a request to its end: a connection that is closed before loses the answer.
fn method(stream: &TcpStream) -> Option<String> {
    let (mut reader, mut first, mut length) = (BufReader::new(stream), None, 0);
    loop {
        let mut line = String::new();
        reader.read_line(&mut line).ok().filter(|read| *read > 0)?;
        let line = line.trim_end().to_ascii_lowercase();
        if line.is_empty() {
            break;
        }
        if let Some(bytes) = line.strip_prefix("content-length:") {
            length = bytes.trim().parse().unwrap();
        }
        first.get_or_insert(line);
    }
    reader.read_exact(&mut vec![0; length]).ok()?;
    Some(first?.split(' ').next()?.to_ascii_uppercase())
}

fn store(answer: impl Fn(&str) -> Answer + Send + 'static) -> Bucket {
    open(&config(serve(answer)))
}

/// A store that gives one answer to HEAD and this error to every other request.
fn failing(head: &str, status: &str, code: &str) -> Bucket {
    let (head, body) = (object(head, 5, "", ""), format!("<Error><Code>{code}</Code></Error>"));
    let failed = answer(status, &body);
    store(move |method| if method == "HEAD" { head.clone() } else { failed.clone() })
}

fn answer(status: &str, body: &str) -> Answer {
    let length = body.len();
    Answer::Whole(format!("HTTP/1.1 {status}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}"))
}

fn object(status: &str, size: usize, range: &str, body: &str) -> Answer {
    Answer::Whole(format!(
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

fn put(bucket: &Bucket) -> Error {
    let (_dir, path) = file();
    bucket.put(NAME, &path).unwrap_err()
}

/// The error has this reason and no secret.
#[track_caller]
fn names(error: &Error, reason: &str) {
    assert_eq!(error.kind(), Kind::Unavailable, "{error}");
    assert!(error.message().contains(reason) && !error.to_string().contains("secret-of-the-"), "{error}");
}

#[test]
fn denied_access_names_the_credentials() {
    for code in ["InvalidAccessKeyId", "SignatureDoesNotMatch", "AccessDenied", "AllAccessDisabled"] {
        names(&put(&failing("403 Forbidden", "403 Forbidden", code)), "AWS_SECRET_ACCESS_KEY");
    }
}

#[test]
fn a_denied_head_names_the_credentials_and_the_clock() {
    let error = failing("403 Forbidden", "403 Forbidden", "RequestTimeTooSkewed").head(NAME).unwrap_err();
    names(&error, "AWS_SECRET_ACCESS_KEY");
    names(&error, "clock");
}

#[test]
fn another_clock_than_that_of_the_store_is_named() {
    let bucket = failing("403 Forbidden", "403 Forbidden", "RequestTimeTooSkewed");
    for error in [put(&bucket), bucket.list("blobs").unwrap_err(), bucket.claim("lab").unwrap_err()] {
        names(&error, "the clock of this machine differs");
        assert!(!error.message().contains("AWS_"), "{error}");
    }
}

#[test]
fn an_expired_session_is_named_without_its_token() {
    let body = "<Error><Code>ExpiredToken</Code><Token-0>secret-of-the-session</Token-0></Error>";
    names(&put(&store(|_| answer("400 Bad Request", body))), "renew AWS_SESSION_TOKEN");
}

#[test]
fn writes_of_read_only_credentials_name_the_missing_permission() {
    let denied = "<Error><Key>robots/blobs/ab/cd</Key><Code>AccessDenied</Code><Message>no</Message></Error>";
    let bucket = store(move |method| match method {
        "HEAD" => object("200 OK", 5, "", ""),
        "GET" => answer("404 Not Found", "<Error><Code>NoSuchKey</Code></Error>"),
        "POST" => answer("200 OK", &format!("<DeleteResult>{denied}</DeleteResult>")),
        _ => answer("403 Forbidden", denied),
    });
    let put_object = "may read and not write: grant them s3:PutObject";
    names(&put(&bucket), put_object);
    names(&bucket.claim("lab").unwrap_err(), put_object);
    names(&bucket.rename(NAME, "trash/cd").unwrap_err(), put_object);
    names(&bucket.remove(NAME).unwrap_err(), "may read and not delete: grant them s3:DeleteObject");
}

#[test]
fn a_missing_bucket_names_the_flag() {
    names(&put(&failing("404 Not Found", "404 Not Found", "NoSuchBucket")), "fix --blob-store");
}

#[test]
fn a_full_store_is_an_error_that_names_its_space() {
    for (status, code) in [
        ("507 Insufficient Storage", "Other"),
        ("403 Forbidden", "QuotaExceeded"),
        ("403 Forbidden", "ServiceQuotaExceededException"),
        ("400 Bad Request", "EntityTooLarge"),
        ("400 Bad Request", "XMinioAdminBucketQuotaExceeded"),
    ] {
        names(&put(&failing("200 OK", status, code)), "the bucket is full");
    }
}

#[test]
fn another_error_is_named_by_its_code() {
    let error = put(&failing("200 OK", "400 Bad Request", "InvalidStorageClass"));
    names(&error, "the store answered InvalidStorageClass; check --blob-store-endpoint");
}

#[test]
fn a_store_that_hangs_names_the_timeout_and_the_endpoint() {
    let begun = Instant::now();
    let error = put(&store(|_| Answer::Hangs(String::new())));
    names(&error, "sent nothing for 1 seconds");
    names(&error, "--blob-store-timeout-seconds");
    names(&error, "--blob-store-endpoint");
    assert!(begun.elapsed().as_secs() < 60);
}

#[test]
fn a_store_that_is_away_names_the_endpoint() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    drop(listener);
    let error = put(&open(&config(format!("http://{address}"))));
    names(&error, "--blob-store-endpoint");
    assert!(!error.message().contains("--blob-store-timeout-seconds"), "{error}");
}

/// Fetches an object of `size` bytes with the digest of `content`.
fn fetch(bucket: &Bucket, content: &str) -> Result<u64, Error> {
    let (_dir, path) = file();
    let to = std::fs::File::create(path).unwrap();
    bucket.fetch(NAME, &BlobId::from(blake3::hash(content.as_bytes())), &to)
}

/// The object of `steps`, whose content the store sends as `body`.
fn stored(body: &'static str) -> Bucket {
    store(move |method| object("200 OK", 5, "", if method == "HEAD" { "" } else { body }))
}

#[test]
fn an_altered_object_is_an_error() {
    let error = fetch(&stored("stepz"), "steps").unwrap_err();
    assert_eq!(error.kind(), Kind::Damaged, "{error}");
    for part in [NAME, "--blob-store", "is damaged", "gleaner-server check"] {
        assert!(error.message().contains(part), "{error}");
    }
}

#[test]
fn a_truncated_object_is_an_error() {
    let error = fetch(&stored("ste"), "steps").unwrap_err();
    assert!(matches!(error.kind(), Kind::Internal | Kind::Unavailable), "{error}");
}

/// A store that sends the head of an answer to GET, and then `rest` as given.
fn in_parts(content: &'static str, rest: impl Fn(String) -> Answer + Send + 'static) -> String {
    serve(move |method| match (method, object("200 OK", content.len(), "", "")) {
        ("GET", Answer::Whole(head)) => rest(head),
        (_, head) => head,
    })
}

#[test]
fn a_slow_store_that_makes_progress_is_read_beyond_the_timeout() {
    let content = "steps of arms";
    let endpoint = in_parts(content, |head| Answer::Slow(head, content.to_owned()));
    let bucket = open(&BucketConfig { timeout_seconds: 2, ..config(endpoint) });
    let begun = Instant::now();
    assert_eq!(fetch(&bucket, content).unwrap(), 13);
    assert!(begun.elapsed().as_secs() >= 2, "the timeout passed");
}

#[test]
fn a_store_that_hangs_within_an_object_names_the_timeout() {
    let bucket = open(&config(in_parts("steps", |head| Answer::Hangs(head + "ste"))));
    names(&fetch(&bucket, "steps").unwrap_err(), "--blob-store-timeout-seconds");
}

#[test]
fn an_endpoint_without_tls_needs_a_flag() {
    let config = BucketConfig { http: false, ..config("http://127.0.0.1:1".to_owned()) };
    let error = Bucket::open_with_key(&config, ("id", &Secret::from("secret".to_owned()))).unwrap_err();
    assert!(error.message().contains("--blob-store-http"), "{error}");
}

#[test]
fn an_endpoint_with_a_password_is_rejected_without_it() {
    for http in [true, false] {
        let config = BucketConfig { http, ..config("http://key:secret-of-the-url@127.0.0.1:1".to_owned()) };
        let error = Bucket::open_with_key(&config, ("id", &Secret::from("secret".to_owned()))).unwrap_err();
        assert!(error.message().contains("AWS_SECRET_ACCESS_KEY"), "{error}");
        assert!(!error.to_string().contains("secret-of-the-url"), "{error}");
    }
}
