//! Hostile clients, on loopback addresses of their own. They run on a thread with idle priority, so that the results include
//! their cost to the server but not their own processor time.

use std::cell::Cell;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::{Duration, Instant};

use futures::StreamExt as _;
use futures::future::join_all;
use futures::stream::{self, FuturesUnordered};
use gleaner_bench_serving::Result;
use gleaner_proto::v1::episode_service_client::EpisodeServiceClient;
use gleaner_proto::v1::task_service_client::TaskServiceClient;
use gleaner_proto::v1::{DownloadEpisodeRequest, ListTasksRequest, Outcome, StartUploadRequest, WriteUploadRequest};
use thread_priority::{
    NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpSocket, TcpStream};
use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;
use tonic::transport::{Channel, Endpoint};

/// The address of the flood.
const FLOOD_FROM: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 66);
/// The address of held connections.
const HOLD_FROM: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 67);
/// The address of slow uploads.
const SLOW_FROM: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 68);
/// Concurrent calls of the flood.
const FLOOD: usize = 100;
/// Downloads that are not read.
const UNREAD: usize = 50;
/// Half of the greeting of an HTTP/2 client.
const HALF: &[u8] = b"PRI * HTTP/";
/// The time between two bytes of a slow upload.
const SLOW_INTERVAL: Duration = Duration::from_millis(500);
/// The pause after a closed connection, because the ports of a machine are limited.
const PAUSE: Duration = Duration::from_millis(2);
/// The longest time that a connection may be held before the test fails.
const LIMIT: Duration = Duration::from_secs(60);

/// The longest lives of silent connections, half greetings and slow uploads, in seconds.
#[derive(Debug, Clone, Copy, Default, serde::Serialize)]
pub(crate) struct Held {
    pub(crate) silent: f64,
    pub(crate) half: f64,
    pub(crate) slow_uploads: f64,
}

impl Held {
    /// The larger value of each.
    pub(crate) fn max(self, other: Self) -> Self {
        Self {
            silent: self.silent.max(other.silent),
            half: self.half.max(other.half),
            slow_uploads: self.slow_uploads.max(other.slow_uploads),
        }
    }
}

/// The objects of the server that hostile clients use.
#[derive(Debug, Clone)]
pub(crate) struct Target {
    pub(crate) url: String,
    pub(crate) task: String,
    pub(crate) episode: String,
}

/// Runs a future on a thread with idle priority.
pub(crate) async fn on_idle_thread<T, F>(work: impl FnOnce() -> F + Send + 'static) -> Result<T>
where
    T: Send + 'static,
    F: Future<Output = Result<T>>,
{
    let (sender, receiver) = oneshot::channel();
    std::thread::Builder::new().name("hostile".to_owned()).spawn(move || {
        lower_priority();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let done = runtime.map_err(Into::into).and_then(|runtime| runtime.block_on(work()));
        // The receiver is gone only when the test has ended.
        let _ = sender.send(done);
    })?;
    receiver.await?
}

/// Gives this thread idle priority: it runs only while a processor is free.
fn lower_priority() {
    let idle = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle);
    // Changing the niceness back requires a privilege; if only that fails, the policy is set nevertheless.
    let _ = set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, idle);
}

/// One hostile client: it floods, sends garbage, and never reads its downloads. Returns the number of the flood's calls
/// that received a response, rejections included.
pub(crate) async fn attack(target: Target, stop: CancellationToken) -> Result<u64> {
    let channel = connect(&target.url, FLOOD_FROM).await?;
    let address = address(&target.url)?;
    let garbage = async {
        while !stop.is_cancelled() {
            send_garbage(address).await;
            tokio::time::sleep(PAUSE).await;
        }
    };
    let responses = Cell::new(0);
    let flood = async {
        let mut calls: FuturesUnordered<_> = (0..FLOOD).map(|_| flood_call(channel.clone())).collect();
        while calls.next().await.is_some() && !stop.is_cancelled() {
            responses.set(responses.get() + 1);
            calls.push(flood_call(channel.clone()));
        }
    };
    let unread = async {
        let mut episodes = EpisodeServiceClient::new(connect(&target.url, FLOOD_FROM).await?);
        let mut unread = Vec::new();
        for _ in 0..UNREAD {
            let request = DownloadEpisodeRequest { episode_id: target.episode.clone(), accept_url: false };
            unread.extend(episodes.download_episode(request).await.ok());
        }
        stop.cancelled().await;
        Result::Ok(())
    };
    let everything = async { tokio::join!(garbage, flood, unread).2 };
    tokio::select! {
        done = everything => done?,
        () = stop.cancelled() => {}
    }
    Ok(responses.get())
}

/// Makes one call of the flood; its result does not matter.
async fn flood_call(channel: Channel) {
    drop(TaskServiceClient::new(channel).list_tasks(ListTasksRequest::default()).await);
}

/// Sends garbage until the server closes the connection.
async fn send_garbage(address: SocketAddr) {
    let Ok(mut stream) = open_socket(address, FLOOD_FROM).await else { return };
    let mut garbage = [0xa5; 4096];
    while stream.write_all(&garbage).await.is_ok() {
        garbage.rotate_left(7);
    }
}

/// Opens silent connections, half greetings and slow uploads, and waits until the server has closed each.
pub(crate) async fn hold_all(target: Target, silent: u32, slow_uploads: u32) -> Result<Held> {
    let address = address(&target.url)?;
    let silences = join_all((0..silent).map(|_| hold(address, b"")));
    let halves = join_all((0..silent).map(|_| hold(address, HALF)));
    let drips = join_all((0..slow_uploads).map(|number| upload_slowly(&target, number)));
    let (silences, halves, drips) = tokio::join!(silences, halves, drips);
    Ok(Held { silent: longest(silences)?, half: longest(halves)?, slow_uploads: longest(drips)? })
}

fn longest(held: Vec<Result<Duration>>) -> Result<f64> {
    let held = held.into_iter().collect::<Result<Vec<_>>>()?;
    Ok(held.into_iter().max().unwrap_or_default().as_secs_f64())
}

/// Measures how long the server keeps a connection that sends only these bytes.
async fn hold(address: SocketAddr, bytes: &[u8]) -> Result<Duration> {
    let mut stream = open_socket(address, HOLD_FROM).await?;
    let begun = Instant::now();
    if stream.write_all(bytes).await.is_err() {
        return Ok(begun.elapsed());
    }
    let mut response = Vec::new();
    // A reset is an end too.
    match tokio::time::timeout(LIMIT, stream.read_to_end(&mut response)).await {
        Ok(_) => Ok(begun.elapsed()),
        Err(_) => Err("a silent connection was not closed in time".into()),
    }
}

/// Measures how long the server accepts an upload of two bytes a second.
async fn upload_slowly(target: &Target, number: u32) -> Result<Duration> {
    let mut episodes = EpisodeServiceClient::new(connect(&target.url, SLOW_FROM).await?);
    let request = StartUploadRequest {
        task: target.task.clone(),
        file_name: format!("slow-{number}.mcap"),
        size_bytes: 10 << 20,
        blake3: format!("{number:064x}"),
        outcome: Outcome::Unknown.into(),
        ..StartUploadRequest::default()
    };
    let upload_id = episodes.start_upload(request).await?.into_inner().upload_id;
    let bytes = stream::unfold(0, move |offset| {
        let upload_id = upload_id.clone();
        async move {
            tokio::time::sleep(SLOW_INTERVAL).await;
            Some((WriteUploadRequest { upload_id, offset, data: vec![0].into() }, offset + 1))
        }
    });
    let begun = Instant::now();
    match tokio::time::timeout(LIMIT, episodes.write_upload(bytes)).await {
        Ok(Ok(_)) => Err("a slow upload succeeded".into()),
        Ok(Err(_)) => Ok(begun.elapsed()),
        Err(_) => Err("a slow upload was not closed in time".into()),
    }
}

async fn connect(url: &str, from: Ipv4Addr) -> Result<Channel> {
    let endpoint = Endpoint::from_shared(url.to_owned())?.local_address(Some(IpAddr::V4(from)));
    Ok(endpoint.connect().await?)
}

async fn open_socket(address: SocketAddr, from: Ipv4Addr) -> std::io::Result<TcpStream> {
    let socket = TcpSocket::new_v4()?;
    socket.bind(SocketAddr::new(from.into(), 0))?;
    socket.connect(address).await
}

fn address(url: &str) -> Result<SocketAddr> {
    Ok(url.strip_prefix("http://").ok_or("not http")?.parse()?)
}
