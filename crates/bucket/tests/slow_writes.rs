//! A store that receives slowly: what one request stores has to be received within the timeout, and the error of a
//! slower store names the flag that raises it.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    io::{BufRead as _, BufReader, Read as _, Result, Write as _},
    net::{TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use gleaner_bucket::{Bucket, BucketConfig};
use gleaner_core::{
    Secret,
    error::{self, Kind},
};

/// The size of the file that is stored, by one request.
const SIZE: usize = 8 << 20;
/// What the store receives after each pause.
const PIECE: usize = 256 << 10;

/// A store that pauses before each piece of what it receives, and counts the bytes; returns its endpoint.
fn serve(pause: Duration, received: &Arc<AtomicUsize>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("http://{}", listener.local_addr().unwrap());
    let received = Arc::clone(received);
    thread::spawn(move || {
        for stream in listener.incoming() {
            // A client that has gone is not an error of the store.
            let _ = receive(&stream.unwrap(), pause, &received);
        }
    });
    endpoint
}

/// Receives one request with a body of [`SIZE`] bytes, and accepts it.
fn receive(stream: &TcpStream, pause: Duration, received: &AtomicUsize) -> Result<()> {
    let mut reader = BufReader::new(stream);
    let mut line = String::new();
    while line != "\r\n" {
        line.clear();
        if reader.read_line(&mut line)? == 0 {
            return Ok(());
        }
    }
    let mut piece = vec![0; PIECE];
    for _ in 0..SIZE / PIECE {
        thread::park_timeout(pause);
        reader.read_exact(&mut piece)?;
        received.fetch_add(PIECE, Ordering::Relaxed);
    }
    reader.get_mut().write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\nETag: \"e\"\r\nConnection: close\r\n\r\n")
}

/// Stores a file of [`SIZE`] bytes at an endpoint.
fn put(endpoint: String, timeout_seconds: u64) -> error::Result<()> {
    let config = BucketConfig {
        url: "s3://lab/robots".to_owned(),
        endpoint: Some(endpoint),
        region: None,
        http: true,
        virtual_host: false,
        timeout_seconds,
    };
    let bucket = Bucket::open_with_key(&config, ("id", &Secret::from("secret-of-the-key".to_owned()))).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("file");
    std::fs::write(&path, vec![7; SIZE]).unwrap();
    bucket.put("blobs/ab/cd", &path)
}

#[test]
fn a_store_that_receives_too_slowly_names_the_timeout() {
    let received = Arc::<AtomicUsize>::default();
    // Five seconds for the file.
    let endpoint = serve(Duration::from_millis(160), &received);
    let error = put(endpoint, 1).unwrap_err();
    assert_eq!(error.kind(), Kind::Unavailable, "{error}");
    for part in ["--blob-store-timeout-seconds", "takes longer to receive 16 MiB"] {
        assert!(error.message().contains(part), "{error}");
    }
    assert!(!error.to_string().contains("secret-of-the-key"), "{error}");
    let received = received.load(Ordering::Relaxed);
    assert!(received < SIZE, "{received} bytes: the store received all");
}

#[test]
fn a_store_that_receives_slowly_has_the_whole_timeout() {
    let (received, begun) = (Arc::<AtomicUsize>::default(), Instant::now());
    let endpoint = serve(Duration::from_millis(40), &received);
    put(endpoint, 60).unwrap();
    assert_eq!(received.load(Ordering::Relaxed), SIZE);
    assert!(begun.elapsed().as_secs() >= 1, "a timeout of a second would have passed");
}
