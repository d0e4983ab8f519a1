//! Lineage: the inputs of a result and the results made from it, one step each way.

use crate::{
    domain::{
        curation::{Input, Lineage},
        id::ScoreRunId,
        job::{Job, JobKind},
    },
    error::{Error, Result},
    store::Store,
};

impl Store {
    /// The inputs of a job's result and the results made from it.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn lineage(&self, job: &Job) -> Result<Lineage> {
        let datasets = match job.spec.kind() {
            JobKind::Score => {
                let run = ScoreRunId::try_from(job.result_id.clone());
                let run = run.map_err(|problem| Error::internal("reading the run of a job", problem))?;
                self.datasets_of_run(&run).await?
            }
            JobKind::Pretrain | JobKind::Train | JobKind::Export | JobKind::Evaluate => Vec::new(),
        };
        let result = job.result_id.as_str();
        let named: Vec<&str> = datasets.iter().map(|dataset| dataset.id.as_str()).chain([result]).collect();
        let mut deployments = self.deployments(Some(&job.task_id)).await?;
        deployments.retain(|deployment| {
            deployment.policy_id().is_some_and(|id| id.as_str() == result)
                || deployment.score_run_id().is_some_and(|id| id.as_str() == result)
        });
        let jobs = self.jobs_naming(&job.task_id, &named).await?;
        Ok(Lineage { inputs: self.inputs(job).await?, jobs, datasets, deployments })
    }

    /// The inputs named by a job's spec, each with the job that made it.
    pub(crate) async fn inputs(&self, job: &Job) -> Result<Vec<(Input, Option<Job>)>> {
        let (mut inputs, dataset) = Input::named(&job.spec);
        if let Some(id) = dataset {
            inputs.push(Input::Dataset(self.dataset(id).await?));
        }
        let mut made = Vec::with_capacity(inputs.len());
        for input in inputs {
            let maker = match input.result_id() {
                Some(result) => self.job_of_result(result).await?,
                None => None,
            };
            made.push((input, maker));
        }
        Ok(made)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        domain::{episode::Outcome, job::JobSpec, selection::Selection},
        store::testing::{self, results},
    };

    fn ids(jobs: &[Job]) -> Vec<&str> {
        jobs.iter().map(|job| job.id.as_str()).collect()
    }

    #[tokio::test]
    async fn lineage_is_found_in_both_directions() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        for outcome in [Outcome::Success, Outcome::Failure] {
            testing::episode(&store, &task, outcome, "").await;
        }
        let encoder = results::encoder(&store, &task).await;
        let run = results::run(&store, &task, &encoder, &[]).await;
        let dataset = store.insert_dataset(&run.id, Selection::beta(0.5)).await.unwrap();
        let spec = JobSpec::Train {
            encoder_id: Some(encoder.id.clone()),
            snapshot_id: encoder.snapshot_id.clone(),
            dataset_id: Some(dataset.id.clone()),
            spec: gleaner_core::TrainSpec::default(),
        };
        let training = results::job(&store, &task, spec, "pol_later").await;
        let policy = results::policy(&store, &task, &encoder, blake3::hash(b"policy").into()).await;
        store
            .deploy(
                "arm",
                &task.id,
                &crate::domain::policy::Assignment {
                    score_run_id: Some(run.id.clone()),
                    ..crate::domain::policy::Assignment::of(&policy.id)
                },
            )
            .await
            .unwrap();

        let of = |id| {
            let store = store.clone();
            async move { store.lineage(&store.job(&id).await.unwrap()).await.unwrap() }
        };
        let pretraining = of(encoder.job_id.clone()).await;
        assert!(matches!(&pretraining.inputs[..], [(Input::Snapshot(id), None)] if *id == encoder.snapshot_id));
        assert_eq!(
            ids(&pretraining.jobs),
            [run.origin.job_id().unwrap().as_str(), training.as_str(), policy.job_id().unwrap().as_str()]
        );
        assert!(pretraining.datasets.is_empty() && pretraining.deployments.is_empty());

        let scoring = of(run.origin.job_id().unwrap().clone()).await;
        assert!(matches!(&scoring.inputs[1], (Input::Encoder(_), Some(job)) if job.id == encoder.job_id));
        assert_eq!(ids(&scoring.jobs), [training.as_str()], "by way of its dataset");
        assert_eq!(scoring.datasets[0].id, dataset.id);
        assert_eq!(scoring.deployments[0].name, "arm", "it scores there");

        let trained = of(training).await;
        let (Input::Dataset(found), Some(maker)) = &trained.inputs[2] else { panic!("{:?}", trained.inputs) };
        assert_eq!((&found.id, &maker.id), (&dataset.id, run.origin.job_id().unwrap()));
        assert!(trained.jobs.is_empty());

        let acting = of(policy.job_id().unwrap().clone()).await;
        assert_eq!(acting.deployments.len(), 1);
        let newer = results::policy(&store, &task, &encoder, blake3::hash(b"newer").into()).await;
        store.deploy("arm", &task.id, &crate::domain::policy::Assignment::of(&newer.id)).await.unwrap();
        assert!(of(policy.job_id().unwrap().clone()).await.deployments.is_empty(), "it no longer acts");
        assert!(of(run.origin.job_id().unwrap().clone()).await.deployments.is_empty());
    }

    #[tokio::test]
    async fn jobs_that_name_a_snapshot_are_those_of_its_task() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        for outcome in [Outcome::Success, Outcome::Failure] {
            testing::episode(&store, &task, outcome, "").await;
        }
        let (one, other) = (results::encoder(&store, &task).await, results::encoder(&store, &task).await);
        let both = [one.snapshot_id.as_str(), other.snapshot_id.as_str()];
        let named = store.jobs_naming(&task.id, &both).await.unwrap();
        assert_eq!(ids(&named), [one.job_id.as_str(), other.job_id.as_str()]);
        assert_eq!(ids(&store.jobs_naming(&task.id, &both[..1]).await.unwrap()), [one.job_id.as_str()]);
        assert!(store.jobs_naming(&task.id, &[]).await.unwrap().is_empty());
        let elsewhere = crate::domain::id::TaskId::new();
        assert!(store.jobs_naming(&elsewhere, &both).await.unwrap().is_empty());
    }
}
