//! What serving a policy costs: load from a process of its own, beside the model alone, beside a training job, and
//! beside the servers that others would write. Knows the server only as a robot does, and as a process.
#![allow(missing_docs, unreachable_pub, reason = "the inside of benches")]

pub mod cli;
pub mod door;
pub mod in_process;
pub mod limits;
pub mod load;
pub mod peers;
pub mod prepare;
pub mod process;
pub mod report;
pub mod scene;
pub mod served;
pub mod targets;
pub mod train;

use self::{
    cli::{Options, Part},
    in_process::InProcess,
    report::Report,
};

/// What can go wrong in a bench: it only ever ends it.
pub type Failure = Box<dyn std::error::Error + Send + Sync>;
pub type Result<T> = std::result::Result<T, Failure>;

/// Measures what was asked for; says whether every target was met.
pub async fn run(options: &Options) -> Result<bool> {
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
