//! Reads from a store that refuses, ends early, ignores ranges or sends too much.

use std::{
    fs::File,
    io::{BufRead as _, BufReader, Read as _, Seek as _, Write as _},
    net::TcpListener,
    thread::JoinHandle,
};

use gleaner_core::error::Kind;

use super::*;

const CONTENT: &[u8] = b"the steps of a recording";

/// A store that gives one answer to each request; returns the URL, and the ranges that were requested.
fn store(answers: Vec<Vec<u8>>) -> (Secret, JoinHandle<Vec<String>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/blob?X-Amz-Signature=secret", listener.local_addr().unwrap());
    let serving = std::thread::spawn(move || {
        let answered = answers.iter().map(|answer| {
            let (mut stream, _) = listener.accept().unwrap();
            let lines = BufReader::new(stream.try_clone().unwrap()).lines().map(|line| line.unwrap().to_lowercase());
            let head: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
            stream.write_all(answer).unwrap();
            head.into_iter().find(|line| line.starts_with("range:")).unwrap_or_default()
        });
        answered.collect()
    });
    (url.into(), serving)
}

fn answer(status: &str, length: usize, body: &[u8]) -> Vec<u8> {
    let head = format!("HTTP/1.1 {status}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n");
    [head.as_bytes(), body].concat()
}

fn part(file: &File) -> Part {
    Part::new(file.try_clone().unwrap(), CONTENT.len() as u64)
}

fn written(mut file: File) -> Vec<u8> {
    let mut bytes = Vec::new();
    file.rewind().unwrap();
    file.read_to_end(&mut bytes).unwrap();
    bytes
}

#[test]
fn an_interrupted_read_resumes_where_it_ended() {
    let rest = answer("206 Partial Content", CONTENT.len() - 9, &CONTENT[9..]);
    let (url, serving) = store(vec![answer("200 OK", CONTENT.len(), &CONTENT[..9]), rest]);
    let (reader, file) = (UrlReader::default(), tempfile::tempfile().unwrap());
    let (begun, failed) = reader.read(&url, part(&file)).unwrap();
    assert_eq!(failed.unwrap_err().kind(), Kind::Unavailable);
    let (whole, read) = reader.read(&url, begun).unwrap();
    read.unwrap();
    assert_eq!(whole.digest(), BlobId::from(blake3::hash(CONTENT)));
    assert_eq!(serving.join().unwrap(), ["", "range: bytes=9-"]);
    assert_eq!(written(file), CONTENT);
}

#[test]
fn a_store_that_ignores_ranges_sends_the_whole_file_again() {
    let whole = answer("200 OK", CONTENT.len(), CONTENT);
    let (url, serving) = store(vec![answer("200 OK", CONTENT.len(), &CONTENT[..9]), whole]);
    let (reader, file) = (UrlReader::default(), tempfile::tempfile().unwrap());
    let (begun, failed) = reader.read(&url, part(&file)).unwrap();
    assert!(failed.is_err());
    let (whole, read) = reader.read(&url, begun).unwrap();
    read.unwrap();
    assert_eq!(whole.digest(), BlobId::from(blake3::hash(CONTENT)));
    serving.join().unwrap();
    assert_eq!(written(file), CONTENT);
}

/// A redirect is refused too: a signed URL is of one host.
#[test]
fn refused_urls_and_wrong_lengths_are_errors_without_the_url() {
    let longer = [CONTENT, b"!"].concat();
    let moved = b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n".to_vec();
    let answers = [
        (answer("403 Forbidden", 0, b""), "403"),
        (answer("200 OK", longer.len(), &longer), "more than the 24 bytes"),
        (answer("200 OK", 3, b"the"), "3 of 24 bytes"),
        (moved, "302"),
    ];
    for (answer, reason) in answers {
        let (url, serving) = store(vec![answer]);
        let file = tempfile::tempfile().unwrap();
        let (_, read) = UrlReader::default().read(&url, part(&file)).unwrap();
        let error = read.unwrap_err();
        assert!(error.kind() == Kind::Unavailable && error.message().contains(reason), "{error}");
        assert!(!error.to_string().contains("secret"), "{error}");
        serving.join().unwrap();
    }
    let free = TcpListener::bind("127.0.0.1:0").unwrap();
    let absent = Secret::from(format!("http://{}/?X-Amz-Signature=secret", free.local_addr().unwrap()));
    drop(free);
    let file = tempfile::tempfile().unwrap();
    let error = UrlReader::default().read(&absent, part(&file)).unwrap().1.unwrap_err();
    assert!(error.kind() == Kind::Unavailable && !error.to_string().contains("secret"), "{error}");
}

#[test]
fn a_closed_reader_stays_closed_for_a_while() {
    let reader = UrlReader::default();
    assert!(reader.is_open());
    reader.close();
    assert!(!reader.is_open());
}
