//! Retries: what failed or was cancelled is ordered anew, and after it what ended because it waited for that.

use std::collections::BTreeMap;

use super::Jobs;
use crate::{
    domain::{
        id::JobId,
        job::{Job, JobKind, JobState},
        order::{JobOrder, Queueing},
    },
    error::{Error, Result},
    store::Store,
};

/// New ids by the old ones they stand in for: of jobs, results and datasets.
type Renamed = BTreeMap<String, String>;

impl Jobs {
    /// Orders anew what a job that failed or was cancelled was to do, and then the jobs that never began because they
    /// waited for it. All get new ids, and so does what they make; keys stay.
    ///
    /// # Errors
    /// NotFound; Precondition when the job may still end well or has; otherwise as for [`Jobs::submit`].
    pub(crate) async fn retry(&self, id: &JobId) -> Result<Job> {
        let store = &self.0.store;
        let job = store.job(id).await?;
        match job.state {
            JobState::Failed | JobState::Cancelled => {}
            JobState::Queued | JobState::Running | JobState::Succeeded => {
                let state = job.state.as_str();
                return Err(Error::precondition(format!(
                    "{id} is {state}; only a job that failed or was cancelled is tried again"
                )));
            }
        }
        let waited = store.ended_with(id, job.state).await?;
        let mut renamed = Renamed::new();
        let first = self.again(&job, &mut renamed).await?;
        for job in &waited {
            self.again(job, &mut renamed).await?;
        }
        tracing::info!(job.id = %id, again.id = %first.id, waited = waited.len(), "a job is tried again");
        Ok(first)
    }

    async fn again(&self, job: &Job, renamed: &mut Renamed) -> Result<Job> {
        let order = with_names(&self.0.store.ordered(job).await?, renamed)?;
        let needs = job.needs.iter().map(|needed| match renamed.get(needed.as_str()) {
            Some(new) => JobId::parse("needs", new),
            None => Ok(needed.clone()),
        });
        let queueing = Queueing {
            priority: job.priority,
            needs: needs.collect::<Result<_>>()?,
            max_attempts: Some(job.max_attempts),
            key: job.key.clone(),
        };
        let new = self.submit(&job.task_id, order, queueing).await?;
        renamed.insert(job.id.to_string(), new.id.to_string());
        renamed.insert(job.result_id.clone(), new.result_id.clone());
        if new.spec.kind() == JobKind::Score {
            same_datasets(&self.0.store, job, &new, renamed).await?;
        }
        Ok(new)
    }
}

/// Looks at the new run through every selection that the old one, which never came to be, had.
async fn same_datasets(store: &Store, old: &Job, new: &Job, renamed: &mut Renamed) -> Result<()> {
    let run = |job: &Job| crate::domain::id::ScoreRunId::parse("result_id", &job.result_id);
    let new = run(new)?;
    for dataset in store.datasets_of_run(&run(old)?).await? {
        let same = store.insert_dataset(&new, dataset.selection).await?;
        renamed.insert(dataset.id.into(), same.id.into());
    }
    Ok(())
}

/// The order with new ids for old ones. An id is in no order but where it is named.
fn with_names(order: &JobOrder, renamed: &Renamed) -> Result<JobOrder> {
    let wrong = |error: serde_json::Error| Error::internal("naming an order's inputs anew", error);
    let mut text = serde_json::to_string(order).map_err(wrong)?;
    for (old, new) in renamed {
        text = text.replace(old.as_str(), new);
    }
    serde_json::from_str(&text).map_err(wrong)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]
    use gleaner_learn::{Device, PretrainSpec, TrainSpec};

    use super::*;
    use crate::{
        domain::{
            attempt::AttemptEnd,
            evaluation::EvaluateSpec,
            job::JobSpec,
            order::{Subject, TrainData},
            schedule::PipelineSpec,
            selection::Selection,
            snapshot::RoleRule,
        },
        error::Kind,
        jobs::testing::Bench,
    };

    fn pipeline() -> PipelineSpec {
        PipelineSpec {
            snapshot_id: None,
            rule: RoleRule::default(),
            pretrain: PretrainSpec::default(),
            score: true,
            scoring: None,
            beta: Some(0.75),
            top_fraction: None,
            train: Some(TrainSpec::default()),
            evaluate: None,
        }
    }

    #[tokio::test]
    async fn what_waited_for_a_failed_job_follows_its_retry() {
        let bench = Bench::new().await;
        let (old, dataset) = bench.jobs.submit_pipeline(&bench.task.id, &pipeline(), 3, None).await.unwrap();
        let refused = bench.jobs.retry(&old[0].id).await.unwrap_err();
        assert!(refused.kind() == Kind::Precondition && refused.message().contains("queued"), "{refused}");
        let (attempt, _) = bench.claim().await;
        bench.store.end_attempt(&attempt, &AttemptEnd::Hopeless("no such device".into())).await.unwrap();
        assert!(old.len() == 3 && bench.store.job(&old[2].id).await.unwrap().state == JobState::Failed);

        let first = bench.jobs.retry(&old[0].id).await.unwrap();
        let (mut all, _) = bench.store.jobs(&crate::domain::order::JobFilter::default(), None, 10).await.unwrap();
        all.reverse();
        let [pretrain, score, train] = &all[3..] else { panic!("not three new jobs") };
        assert_eq!((&pretrain.id, &pretrain.spec, pretrain.priority), (&first.id, &old[0].spec, 3));
        assert_eq!((&score.needs, &train.needs), (&vec![pretrain.id.clone()], &vec![score.id.clone()]));
        let JobSpec::Score { encoder_id, .. } = &score.spec else { panic!("no scoring") };
        assert_eq!(encoder_id.as_str(), pretrain.result_id);
        let JobSpec::Train { encoder_id, dataset_id: Some(new), .. } = &train.spec else { panic!("no training") };
        assert_eq!(encoder_id.as_ref().unwrap().as_str(), pretrain.result_id);
        let new = bench.store.dataset(new).await.unwrap();
        assert_eq!((new.score_run_id.as_str(), new.selection), (score.result_id.as_str(), Selection::Beta(0.75)));
        assert_ne!(Some(new.id), dataset);
    }

    #[tokio::test]
    async fn a_key_stays_with_what_was_ordered_under_it() {
        let bench = Bench::new().await;
        let order = JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec: PretrainSpec::default() };
        let queueing = || Queueing { key: "cell 7".into(), max_attempts: Some(2), ..Queueing::default() };
        let job = bench.jobs.submit(&bench.task.id, order.clone(), queueing()).await.unwrap();
        bench.jobs.cancel(&job.id).await.unwrap();
        let again = bench.jobs.retry(&job.id).await.unwrap();
        assert!(again.id != job.id && (again.key.as_str(), again.max_attempts) == ("cell 7", 2));
        let asked = bench.jobs.submit(&bench.task.id, order, queueing()).await.unwrap();
        assert_eq!(asked, again, "who asks again finds the retry");
        assert_eq!(bench.jobs.retry(&job.id).await.unwrap(), again, "and so does who tries again");
        assert_eq!(bench.jobs.retry(&JobId::new()).await.unwrap_err().kind(), Kind::NotFound);
    }

    #[test]
    fn every_spec_can_be_ordered_again() {
        use crate::domain::id::{DatasetId, EncoderId, PolicyId, SnapshotId};
        let (encoder, snapshot, dataset) = (EncoderId::new(), SnapshotId::new(), DatasetId::new());
        let train = |encoder_id, dataset_id| {
            JobOrder::from(JobSpec::Train {
                encoder_id,
                snapshot_id: snapshot.clone(),
                dataset_id,
                spec: TrainSpec::default(),
            })
        };
        let data = |order| {
            let JobOrder::Train { data, .. } = order else { panic!("no training") };
            data
        };
        assert_eq!(data(train(Some(encoder.clone()), Some(dataset.clone()))), TrainData::Dataset(dataset));
        assert_eq!(data(train(Some(encoder.clone()), None)), TrainData::ExpertsOf(encoder));
        assert_eq!(data(train(None, None)), TrainData::ExpertsIn(snapshot.clone()));
        let policy = PolicyId::new();
        let spec = EvaluateSpec {
            simulation: "pick_cube".into(),
            episodes: 1,
            seeds: vec![4],
            max_steps: 9,
            device: Device::Cpu,
        };
        let order = JobOrder::from(JobSpec::Evaluate { policy_id: policy.clone(), spec: spec.clone() });
        assert_eq!(order, JobOrder::Evaluate { subject: Subject::Policy(policy.clone()), spec });
        let other = PolicyId::new();
        let renamed = Renamed::from([(policy.to_string(), other.to_string())]);
        let JobOrder::Evaluate { subject, .. } = with_names(&order, &renamed).unwrap() else { panic!("no evaluation") };
        assert_eq!(subject, Subject::Policy(other));
    }
}
