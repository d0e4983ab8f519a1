//! Hostile clients. They run on a thread of their own that gets only what is left of the processors, as if they were on
//! machines of their own: what they cost the server is measured, and not what they cost themselves. They come from
//! addresses of their own.

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

/// Of the one that floods, of those that hold connections, and of those that drip.
const FLOODS: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 66);
const HOLDS: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 67);
const DRIPS: Ipv4Addr = Ipv4Addr::new(127, 0, 0, 68);
/// Calls that the flood has under way.
const FLOOD: usize = 100;
/// Downloads that nobody reads.
const UNREAD: usize = 50;
/// Half of what an HTTP/2 client says first.
const HALF: &[u8] = b"PRI * HTTP/";
/// From one byte of a dripping upload to its next.
const DRIP: Duration = Duration::from_millis(500);
/// From one connection that was thrown out to the next: ports of this machine are few.
const AGAIN: Duration = Duration::from_millis(2);
/// What is still held then is held for ever.
const PATIENCE: Duration = Duration::from_secs(60);

/// How long the server held what was held for nothing, at most, in seconds.
#[derive(Debug, Clone, Copy, Default, serde::Serialize)]
pub(crate) struct Held {
    pub(crate) silent: f64,
    pub(crate) half: f64,
    pub(crate) dripping: f64,
}

impl Held {
    /// The worst of both.
    pub(crate) fn or(self, other: Self) -> Self {
        Self {
            silent: self.silent.max(other.silent),
            half: self.half.max(other.half),
            dripping: self.dripping.max(other.dripping),
        }
    }
}

/// What the hostile know of the server.
#[derive(Debug, Clone)]
pub(crate) struct Target {
    pub(crate) url: String,
    pub(crate) task: String,
    pub(crate) episode: String,
}

/// Runs on a thread of its own.
pub(crate) async fn apart<T, F>(work: impl FnOnce() -> F + Send + 'static) -> Result<T>
where
    T: Send + 'static,
    F: Future<Output = Result<T>>,
{
    let (tell, told) = oneshot::channel();
    std::thread::Builder::new().name("hostile".to_owned()).spawn(move || {
        give_way();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let done = runtime.map_err(Into::into).and_then(|runtime| runtime.block_on(work()));
        // Nobody listens only when the test itself is over.
        let _ = tell.send(done);
    })?;
    told.await?
}

/// Has this thread run only when nobody else wants its processor.
fn give_way() {
    let idle = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle);
    // It would give back a niceness too, which only the privileged may; where that is why it fails, the policy holds.
    let _ = set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, idle);
}

/// One hostile client: floods, sends garbage, and never reads what it asked for. Says how many of its flood's calls were
/// answered, if only by a refusal.
pub(crate) async fn harass(target: Target, stop: CancellationToken) -> Result<u64> {
    let channel = connect(&target.url, FLOODS).await?;
    let address = address(&target.url)?;
    let garbage = async {
        while !stop.is_cancelled() {
            throw_garbage(address).await;
            tokio::time::sleep(AGAIN).await;
        }
    };
    let answered = Cell::new(0);
    let flood = async {
        let mut calls: FuturesUnordered<_> = (0..FLOOD).map(|_| ask(channel.clone())).collect();
        while calls.next().await.is_some() && !stop.is_cancelled() {
            answered.set(answered.get() + 1);
            calls.push(ask(channel.clone()));
        }
    };
    let unread = async {
        let mut episodes = EpisodeServiceClient::new(connect(&target.url, FLOODS).await?);
        let mut answers = Vec::new();
        for _ in 0..UNREAD {
            let request = DownloadEpisodeRequest { episode_id: target.episode.clone() };
            answers.extend(episodes.download_episode(request).await.ok());
        }
        stop.cancelled().await;
        Result::Ok(())
    };
    let everything = async { tokio::join!(garbage, flood, unread).2 };
    tokio::select! {
        done = everything => done?,
        () = stop.cancelled() => {}
    }
    Ok(answered.get())
}

/// Refused or not: the flood goes on.
async fn ask(channel: Channel) {
    drop(TaskServiceClient::new(channel).list_tasks(ListTasksRequest::default()).await);
}

/// The server may throw it out at any moment.
async fn throw_garbage(address: SocketAddr) {
    let Ok(mut stream) = dial(address, FLOODS).await else { return };
    let mut garbage = [0xa5; 4096];
    while stream.write_all(&garbage).await.is_ok() {
        garbage.rotate_left(7);
    }
}

/// Holds connections that say nothing or half a greeting, and uploads that drip, until the server has ended each.
pub(crate) async fn besiege(target: Target, silent: u32, dripping: u32) -> Result<Held> {
    let address = address(&target.url)?;
    let silences = join_all((0..silent).map(|_| hold(address, b"")));
    let halves = join_all((0..silent).map(|_| hold(address, HALF)));
    let drips = join_all((0..dripping).map(|number| drip(&target, number)));
    let (silences, halves, drips) = tokio::join!(silences, halves, drips);
    Ok(Held { silent: longest(silences)?, half: longest(halves)?, dripping: longest(drips)? })
}

fn longest(held: Vec<Result<Duration>>) -> Result<f64> {
    let held = held.into_iter().collect::<Result<Vec<_>>>()?;
    Ok(held.into_iter().max().unwrap_or_default().as_secs_f64())
}

/// How long the server keeps a connection that says so much.
async fn hold(address: SocketAddr, words: &[u8]) -> Result<Duration> {
    let mut stream = dial(address, HOLDS).await?;
    let begun = Instant::now();
    if stream.write_all(words).await.is_err() {
        return Ok(begun.elapsed());
    }
    let mut answer = Vec::new();
    // Shut or thrown out: either is an end.
    match tokio::time::timeout(PATIENCE, stream.read_to_end(&mut answer)).await {
        Ok(_) => Ok(begun.elapsed()),
        Err(_) => Err("a connection that says nothing is held for ever".into()),
    }
}

/// How long the server bears an upload of two bytes a second.
async fn drip(target: &Target, number: u32) -> Result<Duration> {
    let mut episodes = EpisodeServiceClient::new(connect(&target.url, DRIPS).await?);
    let request = StartUploadRequest {
        task: target.task.clone(),
        file_name: format!("drip-{number}.mcap"),
        size_bytes: 10 << 20,
        blake3: format!("{number:064x}"),
        outcome: Outcome::Unknown.into(),
        ..StartUploadRequest::default()
    };
    let upload_id = episodes.start_upload(request).await?.into_inner().upload_id;
    let drops = stream::unfold(0, move |offset| {
        let upload_id = upload_id.clone();
        async move {
            tokio::time::sleep(DRIP).await;
            Some((WriteUploadRequest { upload_id, offset, data: vec![0].into() }, offset + 1))
        }
    });
    let begun = Instant::now();
    match tokio::time::timeout(PATIENCE, episodes.write_upload(drops)).await {
        Ok(Ok(_)) => Err("a dripping upload ended well".into()),
        Ok(Err(_)) => Ok(begun.elapsed()),
        Err(_) => Err("a dripping upload is borne for ever".into()),
    }
}

async fn connect(url: &str, from: Ipv4Addr) -> Result<Channel> {
    let endpoint = Endpoint::from_shared(url.to_owned())?.local_address(Some(IpAddr::V4(from)));
    Ok(endpoint.connect().await?)
}

async fn dial(address: SocketAddr, from: Ipv4Addr) -> std::io::Result<TcpStream> {
    let socket = TcpSocket::new_v4()?;
    socket.bind(SocketAddr::new(from.into(), 0))?;
    socket.connect(address).await
}

fn address(url: &str) -> Result<SocketAddr> {
    Ok(url.strip_prefix("http://").ok_or("not http")?.parse()?)
}
