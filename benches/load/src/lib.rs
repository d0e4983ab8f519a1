//! A load test: many well-behaved clients, a hostile one, and thousands of held connections on a real server in a process of
//! its own. It depends on the server's protocol only, not on its code.

mod cli;
mod clients;
mod hostile;
mod report;
mod stats;

use std::path::Path;
use std::time::Duration;

use gleaner_bench_serving::{
    Failure, Result,
    cli::Kind,
    connection::Connection,
    prepare::{Prepared, set_up},
    process::{Program, allow_open_files},
    report::progress,
};
use gleaner_core::Preset;
use gleaner_proto::v1::ListEpisodesRequest;
use tokio::process::Command;
use tokio::task::JoinHandle;
use tokio::time::{Instant, interval};
use tokio_util::sync::CancellationToken;

pub use self::cli::Options;
pub use self::report::Report;
use self::{
    hostile::{Held, Target, attack, hold_all, on_idle_thread},
    stats::{Phase, Stats},
};

/// Alternating phases without and with a hostile client.
const HOSTILE_PHASES: u32 = 4;
/// The period of the single robot.
const RATE: Duration = Duration::from_millis(50);

/// Loads a server.
///
/// # Errors
/// If the load cannot be started. Failed calls are in the report.
pub async fn run(options: &Options) -> Result<Report> {
    allow_open_files()?;
    let folder = tempfile::tempdir()?;
    let server = serve(options, folder.path()).await?;
    let prepared = set_up(&server, Preset::Tiny, Kind::Finetune, folder.path()).await?;
    let target = target(&server, &prepared).await?;
    let stats = Stats::default();

    progress("one robot alone ...");
    let robot = robot(&prepared, &stats).await?;
    measure(&stats, Phase::Alone, options.alone()).await;
    progress("one robot beside held connections ...");
    let held = hold_connections(options, &target, &stats).await?;
    drop(robot);

    progress("all clients ...");
    let clients = clients::start(options, server.url(), &prepared, folder.path(), &stats).await?;
    stats.begin(Phase::Load);
    let memory = watch(&server, options.duration()).await?;
    progress("all clients, alternately with and without a hostile one ...");
    let mut flood = 0;
    for _ in 0..HOSTILE_PHASES / 2 {
        measure(&stats, Phase::Baseline, options.phase()).await;
        flood += hostile_phase(options, &target, &stats).await?;
    }
    drop(clients);
    server.stop().await?;
    Ok(Report::new(options, &stats, memory, (held, flood)))
}

async fn serve(options: &Options, folder: &Path) -> Result<Program> {
    let mut command = Command::new(&options.server_bin);
    command
        .args(["serve", "--listen", "127.0.0.1:0", "--worker-threads", "1"])
        .args(&options.server_flags)
        .arg("--data-dir")
        .arg(folder.join("data"))
        .env("GLEANER_LOG", "warn");
    Program::start(command, &folder.join("server.log")).await
}

async fn target(server: &Program, prepared: &Prepared) -> Result<Target> {
    let request = ListEpisodesRequest { task: prepared.spec.name.clone(), ..ListEpisodesRequest::default() };
    let episodes = prepared.client.episodes().list_episodes(request).await?.into_inner().episodes;
    let episode = episodes.into_iter().next().ok_or("no episode")?.id;
    Ok(Target { url: server.url().to_owned(), task: prepared.spec.name.clone(), episode })
}

/// Starts a robot, which stops on drop.
async fn robot(prepared: &Prepared, stats: &Stats) -> Result<Robot> {
    let connection = Connection::open(&prepared.address).await?;
    Ok(Robot(tokio::spawn(clients::act(connection, clients::scene(prepared)?, interval(RATE), stats.clone()))))
}

struct Robot(JoinHandle<()>);

impl Drop for Robot {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Attributes the calls of this duration to a phase.
async fn measure(stats: &Stats, phase: Phase, time: Duration) {
    stats.begin(phase);
    tokio::time::sleep(time).await;
    stats.begin(Phase::Between);
}

/// Holds connections until the server has closed all, again and again for the duration of the robot's phase.
async fn hold_connections(options: &Options, target: &Target, stats: &Stats) -> Result<Held> {
    let (target, silent, slow_uploads) = (target.clone(), options.silent, options.slow_uploads);
    stats.begin(Phase::Held);
    let until = Instant::now() + options.alone();
    let mut longest: Option<Held> = None;
    while longest.is_none() || Instant::now() < until {
        let target = target.clone();
        let held = on_idle_thread(move || hold_all(target, silent, slow_uploads)).await?;
        longest = Some(longest.map_or(held, |longest| longest.max(held)));
    }
    stats.begin(Phase::Between);
    Ok(longest.unwrap_or_default())
}

/// Runs a phase with a hostile client; returns the number of its calls that received a response.
async fn hostile_phase(options: &Options, target: &Target, stats: &Stats) -> Result<u64> {
    let (target, stop) = (target.clone(), CancellationToken::new());
    let stopping = stop.clone();
    let hostile = tokio::spawn(on_idle_thread(move || attack(target, stopping)));
    measure(stats, Phase::Hostile, options.phase()).await;
    stop.cancel();
    hostile.await.map_err(Failure::from)?
}

/// Measures the memory of the server once a second.
async fn watch(server: &Program, time: Duration) -> Result<Vec<u64>> {
    let (until, mut ticks) = (Instant::now() + time, interval(Duration::from_secs(1)));
    let mut memory = Vec::new();
    while Instant::now() < until {
        ticks.tick().await;
        memory.push(server.memory()?);
    }
    Ok(memory)
}
