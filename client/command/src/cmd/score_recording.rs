//! `score-recording`: scores of a recording that the server does not store.

use std::path::PathBuf;

use clap::Args;
use gleaner_proto::v1::{Finding, Role, Severity};

use super::scores::shown;
use super::selection::{beta_of, threshold};
use crate::context::Context;
use crate::failure::{Result, present};
use crate::json;

#[derive(Args, Debug)]
pub(crate) struct ScoreRecordingArgs {
    /// Id of the score run, which has the experts and the settings.
    run: String,
    /// Path of the recording (MCAP).
    file: PathBuf,
    /// Threshold that the chart shows as a line, 0 to 1. Default: that of the run.
    #[arg(long, value_parser = threshold)]
    beta: Option<f64>,
    /// Also list the nearest expert step of each step with its distances.
    #[arg(long)]
    matches: bool,
}

impl ScoreRecordingArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let bar = context.progress.bytes("send", std::fs::metadata(&self.file).map_or(0, |file| file.len()));
        let drawn = bar.clone();
        let reply = client.score_recording(&self.run, &self.file, move |sent| drawn.set_position(sent)).await;
        bar.finish_and_clear();
        let reply = reply?;
        let scores = present(reply.scores.as_ref(), "scores")?;
        let findings = reply.report.iter().flat_map(|report| &report.findings);
        for finding in findings.filter(|finding| finding.severity() != Severity::Note) {
            context.output.note(found(finding));
        }
        if scores.role() == Role::Expert {
            let expert = &scores.episode_id;
            context
                .output
                .note(format!("the recording has the steps of expert {expert}; compared with the other experts"));
        }
        let what = format!("{} (not stored)", self.file.display());
        let beta = beta_of(&client, &self.run, self.beta).await?;
        let text = || shown(&what, scores, beta, self.matches);
        context.output.result(|| json::value(&reply), text)?;
        context.output.next(format_args!("gleaner push {} (keeps it as an episode)", self.file.display()));
        Ok(())
    }
}

fn found(finding: &Finding) -> String {
    let at = finding.first_step.map(|step| format!(" at step {step}")).unwrap_or_default();
    format!("{} {}{at}: {}", finding.code, finding.subject, finding.detail)
}
