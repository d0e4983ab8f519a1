//! Pages over a plain socket, with their headers.

use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
};

use super::wait::within;

/// Requests a page of a server by its address.
pub async fn get(url: &str) -> String {
    String::from_utf8(bytes(url).await).unwrap()
}

/// Requests a file of a server by its address; returns its bytes after the headers.
pub async fn file(url: &str) -> Vec<u8> {
    let response = bytes(url).await;
    let end = response.windows(4).position(|window| window == b"\r\n\r\n").unwrap();
    response[end + 4..].to_vec()
}

async fn bytes(url: &str) -> Vec<u8> {
    let (address, path) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
    let request = format!("GET /{path} HTTP/1.1\r\nHost: {address}\r\nAccept: text/html, */*\r\n\r\n");
    exchange(address, request.as_bytes()).await
}

/// Sends bytes on a new connection and reads until the server closes it.
pub async fn exchange(address: &str, request: &[u8]) -> Vec<u8> {
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(request).await.unwrap();
    let mut response = Vec::new();
    within("the server closes the connection", stream.read_to_end(&mut response)).await.unwrap();
    response
}
