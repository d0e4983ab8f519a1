//! Tests of the parent module.

use std::cell::RefCell;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use tokio::io::AsyncReadExt as _;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinHandle;

use super::*;

const FILE: &[u8] = b"hello world";

fn digest(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

fn pieces(parts: &[&'static str]) -> impl Stream<Item = Result<Bytes>> + Unpin {
    futures::stream::iter(parts.iter().map(|part| Ok(Bytes::from(*part))).collect::<Vec<_>>())
}

#[tokio::test]
async fn a_complete_download_is_renamed_and_a_damaged_one_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/er/a.mcap");
    let blake3 = digest(FILE);
    let expected = Expected { blake3: &blake3, size_bytes: 11 };
    save(pieces(&["hello ", "world"]), &path, &expected, |_| {}).await.unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), FILE);
    // As readable as a file that is made in the plain way.
    std::fs::write(folder.path().join("plain"), b"").unwrap();
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&path), mode(&folder.path().join("plain")));
    std::fs::remove_file(folder.path().join("plain")).unwrap();

    let other = folder.path().join("b.mcap");
    for damaged in [&["hello ", "word"][..], &["hello ", "world", "!"], &["hello "], &[]] {
        let error = save(pieces(damaged), &other, &expected, |_| {}).await.unwrap_err();
        assert!(matches!(error, ClientError::Damaged { .. }), "{error}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "only the folder of the first is left");
}

/// `/dev/full` fails every write as a full disk does. The last write of a file is under way when it is synced.
#[tokio::test]
async fn an_error_of_the_last_write_is_returned() {
    let mut file = tokio::fs::OpenOptions::new().write(true).open("/dev/full").await.unwrap();
    file.write_all(FILE).await.unwrap();
    let error = sync(&mut file).await.unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::StorageFull, "{error}");
}

#[test]
fn names_outside_the_folder_are_rejected() {
    for name in ["", "/etc/passwd", "../up", "a/../../up"] {
        assert!(relative(name).is_err(), "{name}");
    }
    assert!(relative("a/b.mcap").is_ok());
}

/// A bucket of a few files, each another fault.
struct Bucket {
    address: SocketAddr,
    serving: JoinHandle<()>,
}

impl Drop for Bucket {
    fn drop(&mut self) {
        self.serving.abort();
    }
}

impl Bucket {
    async fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let serving = tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                tokio::spawn(answer(stream));
            }
        });
        Self { address, serving }
    }

    fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }
}

/// Answers one request. What the client does with a broken answer is its own matter.
async fn answer(mut stream: TcpStream) {
    let mut request = Vec::new();
    while !request.ends_with(b"\r\n\r\n") {
        let Ok(byte) = stream.read_u8().await else { return };
        request.push(byte);
    }
    let head = |line: &str| format!("HTTP/1.1 {line}\r\nConnection: close\r\n");
    let path = String::from_utf8(request).unwrap().split(' ').nth(1).unwrap().to_owned();
    let reply = match path.as_str() {
        "/whole" => head("200 OK") + "Content-Length: 11\r\n\r\nhello world",
        "/altered" => head("200 OK") + "Content-Length: 11\r\n\r\nhello worle",
        "/short" => head("200 OK") + "Content-Length: 11\r\n\r\nhello",
        "/elsewhere" => head("302 Found") + "Location: /whole\r\nContent-Length: 0\r\n\r\n",
        "/endless" => head("200 OK") + "\r\n",
        _ => head("403 Forbidden") + "Content-Length: 0\r\n\r\n",
    };
    let _ = stream.write_all(reply.as_bytes()).await;
    while path == "/endless" && stream.write_all(&[7; 4096]).await.is_ok() {}
}

/// The server's side: a URL for those who accept one, and else the bytes.
struct Sender {
    url: String,
    bytes: &'static [u8],
    asked: RefCell<Vec<bool>>,
}

impl Sender {
    fn new(url: String, bytes: &'static [u8]) -> Self {
        Self { url, bytes, asked: RefCell::default() }
    }

    async fn save(&self, direct: &Direct, path: &Path) -> Result<Vec<u8>> {
        let open = async |accept_url| {
            self.asked.borrow_mut().push(accept_url);
            let (data, url) = if accept_url {
                (Bytes::new(), self.url.clone())
            } else {
                (Bytes::from_static(self.bytes), String::new())
            };
            Ok(futures::stream::iter([Ok(Piece { data, url })]))
        };
        let blake3 = digest(FILE);
        download(direct, open, path, &Expected { blake3: &blake3, size_bytes: 11 }, |_| {}).await?;
        Ok(std::fs::read(path).unwrap())
    }
}

fn place() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    (folder, path)
}

#[tokio::test]
async fn file_comes_from_its_url() {
    let (bucket, (_folder, path), direct) = (Bucket::start().await, place(), Direct::new(false));
    let sender = Sender::new(bucket.url("/whole"), b"not sent");
    for _ in 0..2 {
        assert_eq!(sender.save(&direct, &path).await.unwrap(), FILE);
    }
    assert_eq!(*sender.asked.borrow(), [true, true]);
}

#[tokio::test]
async fn file_that_its_url_does_not_give_comes_from_the_server() {
    let bucket = Bucket::start().await;
    for fault in ["/altered", "/short", "/absent", "/elsewhere", "/endless"] {
        let ((folder, path), direct) = (place(), Direct::new(false));
        let sender = Sender::new(bucket.url(fault), FILE);
        for _ in 0..2 {
            assert_eq!(sender.save(&direct, &path).await.unwrap(), FILE, "{fault}");
        }
        assert_eq!(*sender.asked.borrow(), [true, false, false], "{fault}: a bucket that failed now is not asked");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "{fault}");
    }
}

#[tokio::test]
async fn bucket_that_failed_is_tried_again_after_a_rest() {
    let (bucket, (_folder, path)) = (Bucket::start().await, place());
    let direct = Direct::new(false).resting(Duration::ZERO);
    let failing = Sender::new(bucket.url("/absent"), FILE);
    assert_eq!(failing.save(&direct, &path).await.unwrap(), FILE);
    let whole = Sender::new(bucket.url("/whole"), b"not sent");
    assert_eq!(whole.save(&direct, &path).await.unwrap(), FILE);
    assert_eq!(*whole.asked.borrow(), [true]);
}

#[tokio::test]
async fn bucket_without_encryption_is_not_asked_behind_a_server_with_it() {
    let (bucket, (_folder, path), direct) = (Bucket::start().await, place(), Direct::new(true));
    let sender = Sender::new(bucket.url("/whole"), FILE);
    assert_eq!(sender.save(&direct, &path).await.unwrap(), FILE);
    assert_eq!(*sender.asked.borrow(), [true, false]);
}

#[tokio::test]
async fn damage_at_both_is_an_error() {
    let (bucket, (folder, path), direct) = (Bucket::start().await, place(), Direct::new(false));
    let sender = Sender::new(bucket.url("/altered"), b"other");
    let error = sender.save(&direct, &path).await.unwrap_err();
    assert!(matches!(error, ClientError::Damaged { .. }), "{error}");
    assert!(!error.to_string().contains("http"), "the URL is a secret: {error}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
