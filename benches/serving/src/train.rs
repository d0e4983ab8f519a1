//! Training jobs: short ones for the policy, and an endless one that keeps the machine busy.

use gleaner_client::Client;
use gleaner_core::{Preset, Words as _};
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::{CancelJobRequest, Job, JobSpec, PretrainSpec, SubmitJobRequest, WatchJobRequest};
use gleaner_recording::TaskSpec;

use crate::Result;

/// More steps than fit into any measurement.
const ENDLESS: u32 = 1_000_000;

/// Settings of a job; missing ones have their default.
pub fn settings(given: &[(&str, serde_json::Value)]) -> Option<prost_types::Struct> {
    let values = given.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
    Some(gleaner_core::proto::to_struct(&values))
}

pub fn pretraining(preset: Preset, steps: u32) -> Spec {
    // The PyTorch model beside it has this token.
    let token = ("action_token", "proprioception".into());
    Spec::Pretrain(PretrainSpec {
        settings: settings(&[("preset", preset.as_str().into()), ("steps", steps.into()), ("batch", 16.into()), token]),
        ..PretrainSpec::default()
    })
}

pub async fn submit(client: &Client, task: &TaskSpec, spec: Spec) -> Result<Job> {
    let request = SubmitJobRequest {
        task: task.name.clone(),
        spec: Some(JobSpec { spec: Some(spec) }),
        ..SubmitJobRequest::default()
    };
    client.jobs().submit_job(request).await?.into_inner().job.ok_or_else(|| "the reply has no job".into())
}

/// A training job that runs until it is stopped.
pub struct Busy<'a> {
    client: &'a Client,
    job: String,
}

impl<'a> Busy<'a> {
    /// Starts the job; returns once it has taken a step.
    pub async fn begin(client: &'a Client, task: &TaskSpec, preset: Preset) -> Result<Self> {
        let job = submit(client, task, pretraining(preset, ENDLESS)).await?.id;
        let mut events = client.jobs().watch_job(WatchJobRequest { job_id: job.clone() }).await?.into_inner();
        while let Some(event) = events.message().await? {
            if !event.metrics.is_empty() {
                return Ok(Self { client, job });
            }
        }
        Err("the training job ended before its first step".into())
    }

    /// The number of its steps so far.
    pub async fn done(&self) -> Result<u64> {
        let request = gleaner_proto::v1::GetJobRequest { job_id: self.job.clone() };
        Ok(self.client.jobs().get_job(request).await?.into_inner().job.map_or(0, |job| job.done))
    }

    pub async fn end(self) -> Result<()> {
        self.client.jobs().cancel_job(CancelJobRequest { job_id: self.job }).await?;
        Ok(())
    }
}
