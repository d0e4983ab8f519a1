//! Retries: a failed or cancelled job is ordered again, followed by the jobs that ended because they waited for it.

use std::collections::BTreeMap;

use serde::{Serialize, de::DeserializeOwned};

use super::{Jobs, kinds};
use crate::{
    domain::{
        dataset::Dataset,
        id::{DatasetId, JobId, ScoreRunId},
        job::{Job, JobKind, JobState},
        order::{Keyed, NewJob, Plan},
        time::Millis,
    },
    error::{Error, Result},
    store::Store,
};

/// New ids by the old ones they replace: of jobs, results and datasets.
type Renamed = BTreeMap<String, String>;

impl Jobs {
    /// Orders a failed or cancelled job again, and then the jobs that never started because they waited for it, except
    /// those that also wait for another failed job. All get new ids, and so do their results; keys stay. They are
    /// queued in one transaction.
    ///
    /// # Errors
    /// NotFound; Precondition when the job has succeeded or may still succeed, or when the job of an input failed;
    /// Exists when an equal job has not ended, so that repeated requests queue it once; otherwise as for
    /// [`Jobs::submit`].
    pub(crate) async fn retry(&self, id: &JobId) -> Result<Job> {
        let store = &self.0.store;
        let job = store.job(id).await?;
        if !gave_up(job.state) {
            let state = job.state.as_str();
            return Err(Error::precondition(format!(
                "{id} is {state}; only a job that failed or was cancelled is tried again"
            )));
        }
        self.0.blobs.room_for(0).await?;
        // Inputs of the spec may have been deleted since.
        kinds::resolve(self, &job.task_id, job.spec.clone().into()).await?;
        let mut again = Again::default();
        again.add(store, &job).await?;
        for waited in store.ended_with(id, job.state).await? {
            if again.may_end_well(store, &waited).await? {
                again.add(store, &waited).await?;
            }
        }
        let plan = Plan { once: true, ..again.plan };
        let jobs = plan.jobs.len();
        let first = self.queue(plan).await?.into_iter().next();
        let first = first.ok_or_else(|| Error::internal("queueing a retry", "the new job has no row"))?;
        tracing::info!(job.id = %id, again.id = %first.id, jobs, "a job is tried again");
        Ok(first)
    }
}

fn gave_up(state: JobState) -> bool {
    match state {
        JobState::Failed | JobState::Cancelled => true,
        JobState::Queued | JobState::Running | JobState::Succeeded => false,
    }
}

/// A plan of new jobs in place of the failed ones.
#[derive(Default)]
struct Again {
    plan: Plan,
    renamed: Renamed,
}

impl Again {
    /// Whether every job that this job needs is in the plan or has not failed.
    async fn may_end_well(&self, store: &Store, job: &Job) -> Result<bool> {
        for needed in job.needs.iter().filter(|needed| !self.renamed.contains_key(needed.as_str())) {
            if gave_up(store.job(needed).await?.state) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Adds a new job in place of `job`; planned jobs that it needs must be added before.
    async fn add(&mut self, store: &Store, job: &Job) -> Result<()> {
        let (id, result_id) = (JobId::new(), kinds::new_result(job.spec.kind()));
        let keyed = if job.key.is_empty() {
            None
        } else {
            let order = with_names(&store.ordered(&job.id).await?, &self.renamed)?;
            Some(Keyed { key: job.key.clone(), order })
        };
        let needs = job.needs.iter().map(|needed| match self.renamed.get(needed.as_str()) {
            Some(new) => JobId::parse("needs", new),
            None => Ok(needed.clone()),
        });
        self.plan.jobs.push(NewJob {
            id: id.clone(),
            task_id: job.task_id.clone(),
            spec: with_names(&job.spec, &self.renamed)?,
            result_id: result_id.clone(),
            priority: job.priority,
            max_attempts: job.max_attempts,
            engine_options: job.engine_options.clone(),
            needs: needs.collect::<Result<_>>()?,
            keyed,
        });
        if job.spec.kind() == JobKind::Score {
            self.add_datasets(store, job, &result_id).await?;
        }
        self.renamed.insert(job.id.to_string(), id.into());
        self.renamed.insert(job.result_id.clone(), result_id);
        Ok(())
    }

    /// Adds a dataset of the new run for each dataset of the old run, which never finished.
    async fn add_datasets(&mut self, store: &Store, job: &Job, new: &str) -> Result<()> {
        let run = |id: &str| ScoreRunId::parse("result_id", id);
        // The list has the newest first; the new datasets get the order of the old ones.
        for old in store.datasets_of_run(&run(&job.result_id)?).await?.into_iter().rev() {
            let (id, created_at) = (DatasetId::new(), Millis::now());
            self.renamed.insert(old.id.to_string(), id.to_string());
            self.plan.datasets.push(Dataset { id, score_run_id: run(new)?, created_at, ..old });
        }
        Ok(())
    }
}

/// A spec or an order with old ids replaced by new ones. Ids occur only where they name an object.
fn with_names<T: Serialize + DeserializeOwned>(named: &T, renamed: &Renamed) -> Result<T> {
    let wrong = |error: serde_json::Error| Error::internal("replacing a job's inputs", error);
    let mut text = serde_json::to_string(named).map_err(wrong)?;
    for (old, new) in renamed {
        text = text.replace(old.as_str(), new);
    }
    serde_json::from_str(&text).map_err(wrong)
}

#[cfg(test)]
mod tests;
