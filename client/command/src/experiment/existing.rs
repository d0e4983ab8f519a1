//! The stages of earlier runs, found again without submitting any.

use std::collections::HashMap;

use gleaner_client::Client;
use gleaner_core::proto::selection::selection_to_proto;
use gleaner_core::selection::Selection;
use gleaner_proto::v1::{Dataset, Job, ListJobsRequest};
use tonic::Code;

use super::collection::Collections;
use super::known::{known_evaluation, known_run, known_snapshot};
use super::stage::{Graph, Stage, Work};
use super::standing::{Gap, StageResult, Submitted};
use super::state::State;
use super::submit::job_key;
use crate::failure::Result;

const PAGE: u32 = 1_000;

/// The jobs and datasets of an experiment on a server.
pub(crate) struct Existing<'a> {
    client: &'a Client,
    state: &'a State,
    jobs: HashMap<String, Job>,
    datasets: Vec<Dataset>,
}

impl<'a> Existing<'a> {
    pub(crate) async fn on(client: &'a Client, state: &'a State, recordings: &Collections) -> Result<Self> {
        let mut existing = Self { client, state, jobs: HashMap::new(), datasets: Vec::new() };
        for collection in recordings.all() {
            existing.add(&collection.task).await?;
        }
        Ok(existing)
    }

    async fn add(&mut self, task: &str) -> Result<()> {
        let client = self.client;
        self.datasets.extend(match client.every_dataset(task).await {
            Ok(reply) => reply.datasets,
            // The task has never been created there.
            Err(error) if error.code() == Some(Code::NotFound) => return Ok(()),
            Err(error) => return Err(error.into()),
        });
        let mut request = ListJobsRequest { task: task.to_owned(), page_size: PAGE, ..ListJobsRequest::default() };
        loop {
            let reply = client.jobs().list_jobs(request.clone()).await?.into_inner();
            for job in reply.jobs.into_iter().filter(|job| !job.key.is_empty()) {
                // After one that failed there may be another under the same key; ids grow with time.
                if self.jobs.get(&job.key).is_none_or(|other| other.id < job.id) {
                    self.jobs.insert(job.key.clone(), job);
                }
            }
            if reply.next_page_token.is_empty() {
                return Ok(());
            }
            request.page_token = reply.next_page_token;
        }
    }

    /// Every stage's result, if it was submitted.
    pub(crate) async fn stages(&self, graph: &Graph) -> Result<Submitted> {
        let mut found = Submitted::with_capacity(graph.stages.len());
        for stage in &graph.stages {
            let input = match stage.input.map(|index| &found[index]) {
                Some(Ok(result)) => Some(result.id.as_str()),
                Some(Err(_)) => None,
                None => Some(""),
            };
            let result = match input {
                Some(input) => self.stage(stage, input).await?,
                None => None,
            };
            found.push(result.ok_or(Gap::NotYet));
        }
        Ok(found)
    }

    async fn stage(&self, stage: &Stage, input: &str) -> Result<Option<StageResult>> {
        match &stage.work {
            Work::Given { origin } => Ok(Some(StageResult { id: origin.id().to_owned(), job: None })),
            Work::Snapshot { .. } => known_snapshot(self.client, self.state, &stage.key).await,
            Work::Marks => known_run(self.client, self.state, &job_key(stage, input)).await,
            Work::Attempts { .. } => known_evaluation(self.client, self.state, &job_key(stage, input)).await,
            Work::Dataset { selection } => Ok(self.dataset(input, *selection)),
            Work::Pretrain { .. } | Work::Score { .. } | Work::Train { .. } | Work::Evaluate { .. } => {
                let job = self.jobs.get(&job_key(stage, input));
                Ok(job.map(|job| StageResult { id: job.result_id.clone(), job: Some(job.clone()) }))
            }
        }
    }

    fn dataset(&self, run: &str, selection: Selection) -> Option<StageResult> {
        let selection = Some(selection_to_proto(selection));
        let same = |dataset: &&Dataset| dataset.score_run_id == run && dataset.selection == selection;
        self.datasets.iter().find(same).map(|dataset| StageResult { id: dataset.id.clone(), job: None })
    }
}
