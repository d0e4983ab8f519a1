//! `demo`: a preset of `experiment`, once on a temporary server, with a report of its own.
//!
//! `demo.toml` is the experiment and `plan` reads it; `run` does its work and evaluates both policies over the endpoint
//! that robots use; `report` and `figure` show the results.

mod figure;
mod plan;
mod report;
mod run;

use std::path::{Path, PathBuf};

use clap::Args;
use gleaner_client::{Client, ClientError};

use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::figure::spread;
use crate::own_server::ServerProcess;
use crate::quality::histogram;
use plan::{Plan, QUICK};
use report::Report;
use run::{Found, Run};

// Marks a folder's data as a demo's, so that the next demo may delete them.
const MARKER: &str = ".gleaner-demo";
const DATA: &str = "data";
const RECORDINGS: &str = "recordings";

#[derive(Args, Debug)]
pub(crate) struct DemoArgs {
    /// Path of the gleaner-server binary.
    #[arg(long, value_name = "PATH")]
    server_bin: PathBuf,
    /// Folder for the server's data, the recordings and the report.
    #[arg(long, value_name = "DIR")]
    dir: PathBuf,
    /// Use the smallest sizes that run every stage; the numbers have no meaning.
    #[arg(long)]
    quick: bool,
    /// TOML file with the settings that differ from the full demo, in the form of an experiment's file (its tables data and base).
    #[arg(long, value_name = "TOML", conflicts_with = "quick")]
    plan: Option<PathBuf>,
}

impl DemoArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let plan = self.plan()?;
        fresh(&self.dir)?;
        let log = self.dir.join("server.log");
        // One for each policy.
        let (data, workers) = (self.dir.join(DATA), ["--workers", "2"]);
        let server = ServerProcess::start(&self.server_bin, &data, &log, &workers, "interrupted").await?;
        context.output.note(format_args!("server at {}, its log in {}", server.url(), log.display()));
        let recordings = self.dir.join(RECORDINGS);
        let work = async |client: Client| Run::new(context, &client, &plan).run(&recordings).await;
        let found = server.during(work).await?;
        write(&self.dir, &found)?;
        context.output.result(|| document(&found.report), || found.report.markdown())?;
        context.output.next(format_args!(
            "open {}, or browse the pages at http://127.0.0.1:7401: {} serve --data-dir {} --web-listen 127.0.0.1:7401",
            self.dir.join("report.md").display(),
            self.server_bin.display(),
            self.dir.join(DATA).display()
        ));
        Ok(())
    }

    fn plan(&self) -> Result<Plan> {
        let Some(path) = &self.plan else {
            return Plan::with(if self.quick { QUICK } else { "" }).map_err(Failure::message);
        };
        let text = std::fs::read_to_string(path).map_err(ClientError::io(path))?;
        Plan::with(&text).map_err(|problem| Failure::message(format!("{}: {problem}", path.display())))
    }
}

// A folder without data: new, or cleared of an earlier demo's data, the only files that are ever deleted.
fn fresh(folder: &Path) -> Result<()> {
    let marker = folder.join(MARKER);
    for part in [DATA, RECORDINGS].map(|part| folder.join(part)) {
        if !part.exists() {
            continue;
        }
        if !marker.exists() {
            return Err(Failure::message(format!(
                "{} exists and is not from a demo; choose another --dir",
                part.display()
            )));
        }
        std::fs::remove_dir_all(&part).map_err(ClientError::io(part))?;
    }
    std::fs::create_dir_all(folder).map_err(ClientError::io(folder))?;
    std::fs::write(&marker, b"").map_err(ClientError::io(marker))?;
    Ok(())
}

fn document(report: &Report) -> Result<serde_json::Value> {
    serde_json::to_value(report).map_err(|error| Failure::message(error.to_string()))
}

fn write(folder: &Path, found: &Found) -> Result<()> {
    let pictures = "\n![steps by q](histogram.svg)\n\n![q along episodes](curves.svg)\n";
    for (name, text) in [
        ("report.md", found.report.markdown() + pictures),
        ("report.json", format!("{:#}\n", document(&found.report)?)),
        ("histogram.svg", spread("", &histogram(&found.episodes), &found.report.experts, &found.report.cohorts)?),
        ("curves.svg", figure::curves(&found.episodes)),
    ] {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(ClientError::io(path))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_files_of_an_earlier_demo_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join(DATA);
        std::fs::create_dir(&data).unwrap();
        std::fs::write(data.join("precious"), b"x").unwrap();
        let message = fresh(folder.path()).unwrap_err().to_string();
        assert!(message.contains("not from a demo") && data.join("precious").exists(), "{message}");

        let other = tempfile::tempdir().unwrap();
        fresh(other.path()).unwrap();
        std::fs::create_dir(other.path().join(DATA)).unwrap();
        fresh(other.path()).unwrap();
        assert!(!other.path().join(DATA).exists());
    }
}
