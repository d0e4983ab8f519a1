//! What serving a policy costs: load from a process of its own, beside the model alone, beside a training job, and
//! beside the servers that others would write. Knows the server only as a robot does, and as a process.

mod cli;
mod door;
mod in_process;
mod limits;
mod load;
mod peers;
mod prepare;
mod process;
mod report;
mod scene;
mod served;
mod train;

use std::process::ExitCode;

use clap::Parser as _;

use self::{
    cli::{Options, Part},
    in_process::InProcess,
    report::Report,
};

/// What can go wrong in a bench: it only ever ends it.
type Failure = Box<dyn std::error::Error + Send + Sync>;
type Result<T> = std::result::Result<T, Failure>;

/// One thread: the load must not take more of the machine than it needs.
#[tokio::main(flavor = "current_thread")]
async fn main() -> ExitCode {
    match run(&Options::parse()).await {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            report::say(&format!("bench-serving: {error}"));
            ExitCode::FAILURE
        }
    }
}

/// Measures what was asked for; says whether every target was met.
async fn run(options: &Options) -> Result<bool> {
    process::allow_open_files()?;
    let folder = tempfile::tempdir()?;
    let mut report = Report::begin(options);
    let (server, prepared) = prepare::prepare(options, folder.path()).await?;
    let mut alone = InProcess::load(&prepared)?;
    if options.has(Part::Load) {
        served::alone(options, &prepared, &mut alone, &mut report).await?;
    }
    if options.has(Part::Training) {
        served::beside_training(options, &prepared, &mut alone, &mut report).await?;
    }
    if options.has(Part::Peers) {
        peers::beside_peers(options, &prepared, folder.path(), &mut report).await?;
    }
    if options.has(Part::Limits) {
        limits::idle(options, &server, &prepared, &mut report).await?;
    }
    server.stop().await?;
    if options.has(Part::Limits) {
        limits::unread(options, folder.path(), &prepared, &mut report).await?;
    }
    report.finish(options.out.as_deref())
}
