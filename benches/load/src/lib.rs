//! Many clients at once on a real server in a process of its own: good ones that upload, ask and act, one that is hostile,
//! and thousands that hold connections for nothing. Knows the server only as clients do, and as a process.

mod cli;
mod crowd;
mod hostile;
mod report;
mod tally;

use std::path::Path;
use std::time::Duration;

use gleaner_bench_serving::{
    Failure, Result,
    door::Door,
    prepare::{Prepared, furnish},
    process::{Program, allow_open_files},
    report::say,
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
    hostile::{Held, Target, apart, besiege, harass},
    tally::{Part, Tally},
};

/// Times without and with a hostile client.
const TURNS: u32 = 4;
/// Of the robot that is looked at alone.
const RATE: Duration = Duration::from_millis(50);

/// Loads a server.
///
/// # Errors
/// When the load itself cannot be made. Calls that the server fails are in the report.
pub async fn run(options: &Options) -> Result<Report> {
    allow_open_files()?;
    let folder = tempfile::tempdir()?;
    let server = serve(options, folder.path()).await?;
    let prepared = furnish(&server, Preset::Tiny, folder.path()).await?;
    let target = target(&server, &prepared).await?;
    let tally = Tally::default();

    say("one robot alone ...");
    let robot = robot(&prepared, &tally).await?;
    measure(&tally, Part::Alone, options.alone()).await;
    say("one robot beside those who hold connections ...");
    let held = siege(options, &target, &tally).await?;
    drop(robot);

    say("all clients at work ...");
    let crowd = crowd::gather(options, server.url(), &prepared, folder.path(), &tally).await?;
    tally.begin(Part::Crowd);
    let memory = watch(&server, options.crowded()).await?;
    say("and a hostile one, now and then ...");
    let mut flood = 0;
    for _ in 0..TURNS / 2 {
        measure(&tally, Part::Peaceful, options.turn()).await;
        flood += hostile_turn(options, &target, &tally).await?;
    }
    drop(crowd);
    server.stop().await?;
    Ok(Report::new(options, &tally, memory, (held, flood)))
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

/// A robot at its rate, until it is dropped.
async fn robot(prepared: &Prepared, tally: &Tally) -> Result<Robot> {
    let door = Door::open(&prepared.address).await?;
    Ok(Robot(tokio::spawn(crowd::act(door, crowd::scene(prepared)?, interval(RATE), tally.clone()))))
}

struct Robot(JoinHandle<()>);

impl Drop for Robot {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Counts what is done for so long under a part of the test.
async fn measure(tally: &Tally, part: Part, time: Duration) {
    tally.begin(part);
    tokio::time::sleep(time).await;
    tally.begin(Part::Between);
}

/// Holds connections until the server has ended all, and then for as long as the robot was alone.
async fn siege(options: &Options, target: &Target, tally: &Tally) -> Result<Held> {
    let (target, silent, dripping) = (target.clone(), options.silent, options.dripping);
    tally.begin(Part::Besieged);
    let until = Instant::now() + options.alone();
    let mut worst: Option<Held> = None;
    while worst.is_none() || Instant::now() < until {
        let target = target.clone();
        let held = apart(move || besiege(target, silent, dripping)).await?;
        worst = Some(worst.map_or(held, |worst| worst.or(held)));
    }
    tally.begin(Part::Between);
    Ok(worst.unwrap_or_default())
}

/// How many calls the hostile client got an answer to.
async fn hostile_turn(options: &Options, target: &Target, tally: &Tally) -> Result<u64> {
    let (target, stop) = (target.clone(), CancellationToken::new());
    let stopping = stop.clone();
    let hostile = tokio::spawn(apart(move || harass(target, stopping)));
    measure(tally, Part::Hostile, options.turn()).await;
    stop.cancel();
    hostile.await.map_err(Failure::from)?
}

/// The server's memory, once a second.
async fn watch(server: &Program, time: Duration) -> Result<Vec<u64>> {
    let (until, mut ticks) = (Instant::now() + time, interval(Duration::from_secs(1)));
    let mut memory = Vec::new();
    while Instant::now() < until {
        ticks.tick().await;
        memory.push(server.memory()?);
    }
    Ok(memory)
}
