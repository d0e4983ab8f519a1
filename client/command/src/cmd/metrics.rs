//! `metrics`: the curves of a job, as a table, JSON or an event file of TensorBoard.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use clap::Args;
use gleaner_client::ClientError;
use gleaner_proto::v1::{GetJobRequest, Job, ListMetricsRequest, Metric};
use jiff::Timestamp;
use serde_json::{Value, json};

use crate::context::Context;
use crate::failure::{Result, present};
use crate::table::Column::{Left, Right};
use crate::table::table;
use crate::tensorboard::{self, Scalar};
use crate::words;

#[derive(Args, Debug)]
pub(crate) struct MetricsArgs {
    /// Id of the job.
    id: String,
    /// Also write the curves as an event file into this folder, which TensorBoard shows and `wandb sync` uploads. A
    /// second run replaces the file of the job.
    #[arg(long, value_name = "DIR")]
    tensorboard: Option<PathBuf>,
}

impl MetricsArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let reply = client.jobs().get_job(GetJobRequest { job_id: self.id.clone() }).await?.into_inner();
        let job = present(reply.job, "a job")?;
        let request = ListMetricsRequest { job_id: self.id };
        let metrics = client.jobs().list_metrics(request).await?.into_inner().metrics;
        let written = self.tensorboard.as_deref().map(|folder| write(folder, &job, &metrics)).transpose()?;
        context.output.result(|| Ok(document(&job, &metrics)), || shown(&metrics))?;
        match written {
            Some(path) => {
                let folder = path.parent().unwrap_or(&path).display();
                context.output.next(format_args!("tensorboard --logdir {folder} (wrote {})", path.display()));
            }
            None => context.output.next(format_args!("gleaner metrics {} --tensorboard DIR", job.id)),
        }
        Ok(())
    }
}

/// Each curve: its steps and values.
pub(super) fn curves(metrics: &[Metric]) -> BTreeMap<&str, Vec<(u64, f64)>> {
    let mut curves: BTreeMap<&str, Vec<(u64, f64)>> = BTreeMap::new();
    for Metric { step, name, value } in metrics {
        curves.entry(name).or_default().push((*step, *value));
    }
    curves
}

fn document(job: &Job, metrics: &[Metric]) -> Value {
    let curve = |(name, points): (&str, Vec<(u64, f64)>)| {
        let (steps, values): (Vec<u64>, Vec<f64>) = points.into_iter().unzip();
        (name.to_owned(), json!({ "steps": steps, "values": values }))
    };
    let curves: serde_json::Map<String, Value> = curves(metrics).into_iter().map(curve).collect();
    json!({ "job": job.id, "kind": words::job_kind(job.kind()), "curves": curves })
}

fn shown(metrics: &[Metric]) -> String {
    let row = |(name, points): (&str, Vec<(u64, f64)>)| {
        let (first, last) = (points.first().copied().unwrap_or_default(), points.last().copied().unwrap_or_default());
        let values = || points.iter().map(|(_, value)| *value);
        [
            name.to_owned(),
            points.len().to_string(),
            last.0.to_string(),
            format!("{:.5}", first.1),
            format!("{:.5}", last.1),
            format!("{:.5}", values().fold(f64::INFINITY, f64::min)),
        ]
    };
    let columns = [Left("METRIC"), Right("VALUES"), Right("LAST STEP"), Right("FIRST"), Right("LAST"), Right("LEAST")];
    table(columns, curves(metrics).into_iter().map(row))
}

/// Writes the event file of a job, under a name that a second run gives again.
pub(super) fn write(folder: &Path, job: &Job, metrics: &[Metric]) -> Result<PathBuf> {
    let seconds =
        |time: Option<&prost_types::Timestamp>| words::timestamp(time).map(|time| time.as_duration().as_secs_f64());
    let begun = seconds(job.start_time.as_ref()).or_else(|| seconds(job.create_time.as_ref())).unwrap_or_default();
    let ended = seconds(job.end_time.as_ref()).unwrap_or_else(|| Timestamp::now().as_duration().as_secs_f64());
    let last = metrics.iter().map(|metric| metric.step).max().unwrap_or_default().max(1);
    let kind = words::job_kind(job.kind());
    let scalar = |Metric { step, name, value }: &Metric| {
        // Metrics have no time: the steps of a job take about the same time.
        #[expect(clippy::cast_precision_loss, reason = "steps are far below 2^52")]
        let share = *step as f64 / last as f64;
        let wall_time = begun + (ended - begun).max(0.0) * share;
        Scalar { tag: format!("{kind}/{name}"), step: *step, value: *value, wall_time }
    };
    let scalars: Vec<Scalar> = metrics.iter().map(scalar).collect();
    std::fs::create_dir_all(folder).map_err(ClientError::io(folder))?;
    // Not the time of the attempt, which a further one changes.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time after 1970, in seconds")]
    let created = seconds(job.create_time.as_ref()).unwrap_or_default() as u64;
    let path = folder.join(format!("events.out.tfevents.{created}.{}", job.id));
    let file = File::create(&path).map_err(ClientError::io(&path))?;
    tensorboard::write(&mut BufWriter::new(file), begun, &scalars).map_err(ClientError::io(&path))?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_are_listed_and_written() {
        let metric = |step, name: &str, value| Metric { step, name: name.into(), value };
        let metrics = [metric(1, "loss", 2.0), metric(2, "loss", 0.5), metric(2, "ms_per_step", 9.0)];
        let text = shown(&metrics);
        assert!(text.lines().nth(1).unwrap().starts_with("loss              2          2  2.00000  0.50000"), "{text}");
        let job = Job { id: "job_1".into(), ..Job::default() };
        assert_eq!(document(&job, &metrics)["curves"]["loss"], json!({ "steps": [1, 2], "values": [2.0, 0.5] }));
        let folder = tempfile::tempdir().unwrap();
        let path = write(&folder.path().join("runs"), &job, &metrics).unwrap();
        assert!(path.ends_with("runs/events.out.tfevents.0.job_1") && path.metadata().unwrap().len() > 100);
        assert_eq!(write(&folder.path().join("runs"), &job, &metrics).unwrap(), path);
    }
}
