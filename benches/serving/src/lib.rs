//! The cost of serving a policy: load from another process, compared with the model alone, with a concurrent training job,
//! and with typical Python servers. It depends on the server's protocol only, not on its code.
#![allow(missing_docs, unreachable_pub, reason = "the inside of benches")]

pub mod cli;
pub mod connection;
pub mod in_process;
pub mod interrupt;
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

/// An error of a bench, which ends it.
pub type Failure = Box<dyn std::error::Error + Send + Sync>;
pub type Result<T> = std::result::Result<T, Failure>;

/// Runs the selected measurements; returns whether every target was met.
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
    server.stop().await?;
    if options.has(Part::Limits) {
        limits::idle(options, folder.path(), &prepared, &mut report).await?;
        limits::unread(options, folder.path(), &prepared, &mut report).await?;
    }
    report.finish(options.out.as_deref())
}
