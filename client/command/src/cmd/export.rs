//! `export`: a dataset as files, made by a job, fetched and verified; or one whole episode with its scores.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, ValueEnum};
use gleaner_client::{Client, expect_new_folder};
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::{
    ExportFormat, ExportSpec, GetEpisodeRequest, GetEpisodeResponse, JobSpec, ListExportFilesResponse, SubmitJobRequest,
};

use super::follow;
use super::newest_run::{self, Missing};
use super::queueing::{JobArgs, queued};
use super::selection::{beta_of, threshold};
use super::submit::task_of_dataset;
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::{json, words};

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FormatArg {
    /// The original messages of each kept run of segments with their scores, and a manifest as JSON lines and Parquet.
    Mcap,
    /// A LeRobot dataset v3.0 with images in parquet, or with --video; each kept run of segments is an episode.
    Lerobot,
    /// One HDF5 file for robomimic; each kept run of segments is a demonstration.
    Robomimic,
}

/// Both forms of the command.
const USAGE: &str = "gleaner export [OPTIONS] --out <PATH> <DATASET>
       gleaner export [OPTIONS] --out <PATH> --episode <EPISODE> [--scores <RUN>]";

#[derive(Args, Debug)]
#[command(override_usage = USAGE)]
pub(crate) struct ExportArgs {
    /// Id of the dataset.
    #[arg(required_unless_present = "episode")]
    dataset: Option<String>,
    /// Id of an episode to write whole, with the scores of every step, as one MCAP file.
    #[arg(long, value_name = "EPISODE", conflicts_with_all = ["dataset", "format", "depth", "options", "key"])]
    episode: Option<String>,
    /// Id of the score run of the episode. Default: the newest run of the episode's task that holds the episode.
    #[arg(long, value_name = "RUN", requires = "episode", conflicts_with = "dataset")]
    scores: Option<String>,
    /// Threshold above which a step of the episode is marked as kept, 0 to 1. Default: that of the run.
    #[arg(long, requires = "episode", conflicts_with = "dataset", value_parser = threshold)]
    beta: Option<f64>,
    /// Format of the files.
    #[arg(long, value_enum, default_value = "mcap")]
    format: FormatArg,
    /// Write depth too, which most policies of LeRobot do not accept. MCAP files always have it.
    #[arg(long)]
    depth: bool,
    /// Write pictures as video of AV1 instead of images, for LeRobot: a fraction of the size, with losses, and slow to write
    /// (about 1 s for 30 pictures of 128×128).
    #[arg(long, conflicts_with = "episode")]
    video: bool,
    /// Write every imperfect episode of the score run whole, one file or episode each, instead of its kept runs of
    /// segments: for looking at, and for trainings that draw steps by their weight, which is 0 where a step is not kept.
    #[arg(long, conflicts_with = "episode")]
    whole: bool,
    /// New output folder; with --episode, the new output file.
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    #[command(flatten)]
    job: JobArgs,
}

impl ExportArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        match (&self.dataset, &self.episode) {
            (None, Some(episode)) => self.write_episode(context, episode).await,
            (dataset, _) => self.write_dataset(context, dataset.as_deref().unwrap_or_default()).await,
        }
    }

    async fn write_episode(&self, context: &Context, episode: &str) -> Result<()> {
        let client = context.client().await?;
        let run = match &self.scores {
            Some(run) => run.clone(),
            None => newest_with(context, &client, episode).await?,
        };
        let beta = beta_of(&client, &run, self.beta).await?;
        let episode = client.export_episode(episode, &run, beta, &self.out).await?;
        let steps = words::counted(episode.steps, "step", "steps");
        let text = format!("{} ({steps}) with its scores in {}", episode.id, self.out.display());
        let reply = GetEpisodeResponse { episode: Some(episode), report: None };
        context.output.result(|| json::value(&reply), || text)?;
        context.output.next(format_args!("open {} in Foxglove, Rerun or PlotJuggler", self.out.display()));
        Ok(())
    }

    async fn write_dataset(&self, context: &Context, dataset: &str) -> Result<()> {
        // Before a job works for a folder that cannot be used.
        expect_new_folder(&self.out)?;
        let client = context.client().await?;
        let format = match self.format {
            FormatArg::Mcap => ExportFormat::Mcap,
            FormatArg::Lerobot => ExportFormat::Lerobot,
            FormatArg::Robomimic => ExportFormat::Robomimic,
        };
        let spec = ExportSpec {
            dataset_id: dataset.to_owned(),
            format: format.into(),
            depth: self.depth,
            video: self.video,
            whole: self.whole,
        };
        let request = SubmitJobRequest {
            task: task_of_dataset(&client, None, dataset).await?,
            spec: Some(JobSpec { spec: Some(Spec::Export(spec)) }),
            key: self.job.key.clone(),
            engine_options: self.job.engine.options.clone(),
            ..SubmitJobRequest::default()
        };
        let job = queued(context, &self.job.key, client.submit_job(request).await)?;
        let job = follow::to_success(context, &client, &job.id).await?;

        let files = client.export_files(&job.result_id).await?;
        let total = files.iter().map(|file| file.size_bytes).sum();
        let bar = context.progress.bytes("download", total);
        client.download_export(&job.result_id, &files, &self.out, |bytes| bar.set_position(bytes)).await?;
        let took = bar.elapsed();
        bar.finish_and_clear();
        let reply = ListExportFilesResponse { files, ..Default::default() };
        context.output.result(
            || json::value(&reply),
            || summary(reply.files.len(), total, took, &self.out.display().to_string()),
        )?;
        context.output.next(next(self.format, &self.out));
        Ok(())
    }
}

/// The newest run that holds an episode, which a note names.
async fn newest_with(context: &Context, client: &Client, id: &str) -> Result<String> {
    let request = GetEpisodeRequest { episode_id: id.to_owned() };
    let reply = client.episodes().get_episode(request).await?.into_inner();
    match newest_run::of(client, present(reply.episode.as_ref(), "an episode")?).await? {
        Ok(newest) => {
            context.output.note(newest.note);
            Ok(newest.id)
        }
        Err(why) => Err(Failure::message(unscored(id, &why))),
    }
}

/// Why an episode cannot be written with scores, and what to do.
fn unscored(id: &str, why: &Missing) -> String {
    let why = match why {
        Missing::NoRun => "its task has no score run yet",
        Missing::Elsewhere(lack) => lack,
    };
    format!(
        "{id}: {why}; make a run with `gleaner score --wait`, or get the recording alone with `gleaner download {id}`"
    )
}

fn summary(files: usize, bytes: u64, took: Duration, folder: &str) -> String {
    format!(
        "{}, {:.1} MB, verified, in {folder} ({:.1} MB/s)",
        words::counted(files, "file", "files"),
        words::megabytes(bytes),
        words::rate(bytes, took)
    )
}

fn next(format: FormatArg, folder: &Path) -> String {
    let folder = folder.display();
    match format {
        FormatArg::Mcap => format!("ls {folder} (open the .mcap files in any MCAP viewer)"),
        FormatArg::Lerobot => format!(
            "LeRobotDataset(\"USER/NAME\", root=\"{folder}\"); for the Hub: hf upload USER/NAME {folder} --repo-type dataset \
             && hf repo tag create USER/NAME v3.0 --repo-type dataset"
        ),
        FormatArg::Robomimic => format!("train.data in robomimic's config: {folder}/dataset.hdf5"),
    }
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory as _, Parser as _};

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn an_episode_is_exported_without_naming_a_run() {
        let parsed = |line: &str| Cli::try_parse_from(line.split(' '));
        assert!(parsed("gleaner export --episode ep_1 --out a").is_ok());
        assert!(parsed("gleaner export --episode ep_1 --beta 0.5 --out a").is_ok());
        assert!(parsed("gleaner export --episode ep_1 --key mine --out a").is_err(), "it submits no job");
        let mut command = Cli::command();
        let export = command.find_subcommand_mut("export").unwrap();
        assert!(export.render_usage().to_string().contains("--episode <EPISODE> [--scores <RUN>]"));
        let refused = parsed("gleaner export --out a").unwrap_err().to_string();
        assert!(refused.contains("--episode <EPISODE> [--scores <RUN>]"), "{refused}");
    }

    #[test]
    fn an_episode_without_a_run_has_the_reason_and_what_to_do() {
        let none = unscored("ep_1", &Missing::NoRun);
        assert!(
            none.starts_with("ep_1: its task has no score run yet; make a run with `gleaner score --wait`"),
            "{none}"
        );
        let lack = unscored("ep_1", &Missing::Elsewhere("the score run of the task lacks the episode".into()));
        assert!(lack.contains("lacks the episode; make") && lack.ends_with("`gleaner download ep_1`"), "{lack}");
    }
}
