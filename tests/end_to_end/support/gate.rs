//! A gate before the server of a bucket: it passes requests, holds them, or refuses them with an error of S3, as stores
//! do that are full, hang or do not accept the credentials.

use std::io;

use gleaner_bucket::testing::TestStore;
use tokio::{
    io::{AsyncBufReadExt as _, AsyncReadExt as _, AsyncWriteExt as _, BufReader, copy, sink},
    net::{TcpListener, TcpStream},
    sync::watch,
};

use super::wait::within;

/// The requests that a gate stops.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Scope {
    /// Those that store, copy or remove objects.
    Writes,
    Every,
}

/// What a gate does with requests. Those outside of the scope pass.
#[derive(Clone, Copy)]
enum Rule {
    Pass,
    Hold(Scope),
    /// By the status 403 with this code.
    Refuse(Scope, &'static str),
}

/// An endpoint that leads to a store; it ends with the runtime of its test.
pub struct Gate {
    endpoint: String,
    rule: watch::Sender<Rule>,
    /// The first lines of the requests that were held or refused.
    stopped: watch::Sender<Vec<String>>,
}

impl Scope {
    fn has(self, method: &str) -> bool {
        self == Self::Every || matches!(method, "PUT" | "POST" | "DELETE")
    }
}

impl Rule {
    fn passes(self, method: &str) -> bool {
        match self {
            Self::Pass => true,
            Self::Hold(scope) | Self::Refuse(scope, _) => !scope.has(method),
        }
    }

    fn holds(self, method: &str) -> bool {
        matches!(self, Self::Hold(scope) if scope.has(method))
    }
}

impl Gate {
    /// A gate before this store, which passes every request at first.
    pub async fn before(store: &TestStore) -> Self {
        let behind = store.config("one").endpoint.unwrap();
        let behind = behind.strip_prefix("http://").unwrap().to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = format!("http://{}", listener.local_addr().unwrap());
        let gate = Self { endpoint, rule: watch::Sender::new(Rule::Pass), stopped: watch::Sender::new(Vec::new()) };
        let (rule, stopped) = (gate.rule.subscribe(), gate.stopped.clone());
        tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                let (behind, rule, stopped) = (behind.clone(), rule.clone(), stopped.clone());
                // A client or a store that has gone is not an error of the gate.
                tokio::spawn(async move { drop(relay(client, &behind, rule, &stopped).await) });
            }
        });
        gate
    }

    /// The flags of a bucket behind the gate.
    pub fn flags(&self, store: &TestStore, prefix: &str) -> Vec<String> {
        let bucket = store.config(prefix).url;
        ["--blob-store", &bucket, "--blob-store-endpoint", &self.endpoint, "--blob-store-http"]
            .map(str::to_owned)
            .into()
    }

    /// Passes every request from now on, also those that are held.
    pub fn pass(&self) {
        self.rule.send_replace(Rule::Pass);
    }

    /// Holds the requests of this scope until another rule is set.
    pub fn hold(&self, scope: Scope) {
        self.rule.send_replace(Rule::Hold(scope));
    }

    /// Refuses the requests of this scope with a code of S3, also those that are held.
    pub fn refuse(&self, scope: Scope, code: &'static str) {
        self.rule.send_replace(Rule::Refuse(scope, code));
    }

    /// Returns once the gate has held or refused this many requests of one method for one object.
    pub async fn stopped(&self, method: &str, times: usize) {
        let mut stopped = self.stopped.subscribe();
        let enough = stopped.wait_for(|requests| {
            let count = |one: &String| requests.iter().filter(|other| *other == one).count();
            requests.iter().any(|request| request.starts_with(method) && count(request) >= times)
        });
        drop(within("the gate stops requests", enough).await.unwrap());
    }
}

/// Answers the one request of a connection: by the store, or with the error of the rule.
async fn relay(
    client: TcpStream,
    behind: &str,
    mut rule: watch::Receiver<Rule>,
    stopped: &watch::Sender<Vec<String>>,
) -> io::Result<()> {
    let mut client = BufReader::new(client);
    let Some(head) = read_head(&mut client).await? else { return Ok(()) };
    let first = head.lines().next().unwrap_or_default();
    let method = first.split(' ').next().unwrap_or_default();
    let met = *rule.borrow();
    if !met.passes(method) {
        stopped.send_modify(|requests| requests.push(first.to_owned()));
    }
    let rule = rule.wait_for(|rule| !rule.holds(method)).await.map(|rule| *rule).map_err(io::Error::other)?;
    let mut body = (&mut client).take(body_bytes(&head));
    if let Rule::Refuse(scope, code) = rule
        && scope.has(method)
    {
        // A connection that is closed before its request is read loses the answer.
        copy(&mut body, &mut sink()).await?;
        let text = if method == "HEAD" { String::new() } else { format!("<Error><Code>{code}</Code></Error>") };
        let length = text.len();
        let answer = format!("HTTP/1.1 403 Forbidden\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{text}");
        client.write_all(answer.as_bytes()).await?;
        return client.shutdown().await;
    }
    let mut store = TcpStream::connect(behind).await?;
    // The end of the connection is then the end of the answer.
    let closing = head.replacen("\r\n", "\r\nConnection: close\r\n", 1);
    store.write_all(closing.as_bytes()).await?;
    copy(&mut body, &mut store).await?;
    copy(&mut store, &mut client).await?;
    client.shutdown().await
}

/// The head of a request; `None` if the client closes the connection before.
async fn read_head(client: &mut BufReader<TcpStream>) -> io::Result<Option<String>> {
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        if client.read_line(&mut head).await? == 0 {
            return Ok(None);
        }
    }
    Ok(Some(head))
}

/// The size of the body that follows a head. Clients of S3 name it.
fn body_bytes(head: &str) -> u64 {
    let mut headers = head.lines().filter_map(|line| line.split_once(':'));
    let length = headers.find(|(name, _)| name.eq_ignore_ascii_case("content-length"));
    length.map_or(0, |(_, length)| length.trim().parse().unwrap())
}
