//! `export`: a dataset as files, made by a job, fetched and verified.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::{ExportFormat, ExportSpec, JobSpec, ListExportFilesResponse, SubmitJobRequest};

use super::follow;
use super::submit::task_of_dataset;
use crate::context::Context;
use crate::failure::{Result, present};
use crate::{json, words};

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormatArg {
    /// The original messages of each kept run of segments with their quality, and manifest.jsonl.
    Mcap,
}

#[derive(Args, Debug)]
pub(crate) struct ExportArgs {
    /// Id of the dataset.
    dataset: String,
    /// Format of the files.
    #[arg(long, value_enum, default_value = "mcap")]
    format: FormatArg,
    /// Output folder; created if missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl ExportArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let format = match self.format {
            FormatArg::Mcap => ExportFormat::Mcap,
        };
        let spec = ExportSpec { dataset_id: self.dataset.clone(), format: format.into() };
        let request = SubmitJobRequest {
            task: task_of_dataset(&client, None, &self.dataset).await?,
            spec: Some(JobSpec { spec: Some(Spec::Export(spec)) }),
            ..SubmitJobRequest::default()
        };
        let job = present(client.jobs().submit_job(request).await?.into_inner().job, "a job")?;
        let job = follow::to_success(context, &client, &job.id).await?;

        let files = client.export_files(&job.result_id).await?;
        let total = files.iter().map(|file| file.size_bytes).sum();
        let bar = context.progress.bytes("download", total);
        for file in &files {
            let before = bar.position();
            client
                .download_export_file(&job.result_id, file, &self.out, |bytes| bar.set_position(before + bytes))
                .await?;
        }
        let took = bar.elapsed();
        bar.finish_and_clear();
        let reply = ListExportFilesResponse { files };
        context.output.result(
            || json::value(&reply),
            || summary(reply.files.len(), total, took, &self.out.display().to_string()),
        )?;
        context.output.next(format_args!("ls {} (open the .mcap files in any MCAP viewer)", self.out.display()));
        Ok(())
    }
}

fn summary(files: usize, bytes: u64, took: Duration, folder: &str) -> String {
    format!(
        "{files} files, {:.1} MB, verified, in {folder} ({:.1} MB/s)",
        words::megabytes(bytes),
        words::rate(bytes, took)
    )
}
