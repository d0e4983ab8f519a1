//! `import-scores`: scores made elsewhere become a score run.

use std::path::PathBuf;

use clap::Args;
use gleaner_client::read_scores;
use gleaner_proto::v1::ScoreRun;

use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::json;
use crate::table::facts;

#[derive(Args, Debug)]
pub(crate) struct ImportScoresArgs {
    /// Id of the snapshot that was scored.
    snapshot: String,
    /// Path of the scores: CSV or Parquet with the columns episode (an id, or the file name or BLAKE3 digest of a
    /// recording), step (counted from 0) and q (0 to 1), for every step of every imperfect episode. Scores of experts are
    /// optional.
    file: PathBuf,
    /// What made the scores, shown with the run.
    #[arg(long, default_value = "", hide_default_value = true)]
    source: String,
    /// Id of an encoder of the same task, from which policies that need one start. Default: none.
    #[arg(long, default_value = "", hide_default_value = true)]
    encoder: String,
}

impl ImportScoresArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let Self { snapshot, file, source, encoder } = self;
        // Read before the connection is opened, so that a fault of the file is found without a server.
        let read = tokio::task::spawn_blocking(move || read_scores(&file)).await;
        let episodes = read.map_err(|error| Failure::message(format!("reading the scores: {error}")))??;
        let run = context.client().await?.import_scores(&snapshot, &source, &encoder, episodes).await?;
        context.output.result(|| json::value(&run), || described(&run))?;
        context.output.next(format_args!("gleaner histogram {}", run.id));
        Ok(())
    }
}

fn described(run: &ScoreRun) -> String {
    facts([
        ("score run", run.id.clone()),
        ("snapshot", run.snapshot_id.clone()),
        ("imperfect", run.imperfect_episodes.to_string()),
        ("segments", run.imperfect_segments.to_string()),
    ])
}
