//! Properties of the queue under any sequence of events: only legal state changes, ended jobs stay ended, the number of
//! attempts is limited, and every job ends.

use std::collections::HashMap;

use proptest::prelude::*;

use crate::{
    domain::{
        attempt::{Attempt, AttemptEnd},
        id::{DatasetId, ExportId, JobId},
        job::{Job, JobSpec, JobState},
        order::{NewJob, Plan},
        task::Task,
    },
    error::Kind,
    store::{Store, attempt::Claimant, queue, testing},
};

/// The events of the queue. The numbers choose a job or a running attempt, modulo their count.
#[derive(Debug, Clone)]
enum Event {
    Claim,
    Succeed(usize),
    End(usize, AttemptEnd),
    Cancel(usize),
    /// A call of an attempt that ended long ago.
    Ghost(usize),
}

fn event() -> impl Strategy<Value = Event> {
    let end = prop_oneof![
        Just(AttemptEnd::Stopped),
        Just(AttemptEnd::Broken("killed".to_owned())),
        Just(AttemptEnd::Permanent("wrong".to_owned())),
    ];
    prop_oneof![
        4 => Just(Event::Claim),
        2 => any::<usize>().prop_map(Event::Succeed),
        4 => (any::<usize>(), end).prop_map(|(at, end)| Event::End(at, end)),
        1 => any::<usize>().prop_map(Event::Cancel),
        1 => any::<usize>().prop_map(Event::Ghost),
    ]
}

/// Jobs with their priority, most attempts, and the earlier ones that they need.
fn jobs() -> impl Strategy<Value = Vec<(i32, u32, Vec<bool>)>> {
    let needs = proptest::collection::vec(prop::bool::weighted(0.3), 4);
    proptest::collection::vec((-1..2_i32, 1..4_u32, needs), 1..5)
}

/// The queue under test, and its expected state.
struct Course {
    store: Store,
    ids: Vec<JobId>,
    before: HashMap<JobId, Job>,
    running: Vec<Attempt>,
    over: Vec<Attempt>,
}

impl Course {
    async fn new(store: Store, task: &Task, wanted: Vec<(i32, u32, Vec<bool>)>) -> Self {
        let mut ids: Vec<JobId> = Vec::new();
        let mut jobs = Vec::new();
        for (priority, max_attempts, needed) in wanted {
            let needs = ids.iter().zip(needed).filter(|(_, needed)| *needed).map(|(id, _)| id.clone()).collect();
            let id = JobId::new();
            jobs.push(NewJob {
                id: id.clone(),
                task_id: task.id.clone(),
                spec: JobSpec::Export { dataset_id: DatasetId::new(), spec: Default::default() },
                result_id: ExportId::new().into(),
                priority,
                max_attempts,
                engine_options: String::new(),
                needs,
                keyed: None,
            });
            ids.push(id);
        }
        let made = store.insert_plan(&Plan { jobs, ..Plan::default() }).await.unwrap();
        let before = made.into_iter().map(|job| (job.id.clone(), job)).collect();
        Self { store, ids, before, running: Vec::new(), over: Vec::new() }
    }

    async fn happen(&mut self, event: Event) {
        match event {
            Event::Claim => {
                self.claim().await;
            }
            Event::Succeed(at) => {
                if let Some(attempt) = self.take(at) {
                    self.succeed(&attempt).await;
                }
            }
            Event::End(at, end) => {
                if let Some(attempt) = self.take(at) {
                    assert!(self.store.end_attempt(&attempt, &end).await.unwrap().is_some());
                }
            }
            Event::Cancel(at) => {
                let id = self.ids[at % self.ids.len()].clone();
                let ended = self.before[&id].state.ended();
                match self.store.cancel_job(&id).await {
                    Ok(_) => assert!(!ended, "an ended job was cancelled"),
                    Err(error) => assert!(ended && error.kind() == Kind::Precondition, "{error}"),
                }
            }
            Event::Ghost(at) => {
                if !self.over.is_empty() {
                    let ended_attempt = &self.over[at % self.over.len()];
                    assert!(self.store.end_attempt(ended_attempt, &AttemptEnd::Stopped).await.unwrap().is_none());
                    assert_eq!(self.store.claimant(ended_attempt, "ghost", "").await.unwrap(), Claimant::Over);
                }
            }
        }
        self.check().await;
    }

    async fn claim(&mut self) -> bool {
        let token_hash = JobId::new().to_string();
        let Some(job) = self.store.claim_job(&token_hash, "local").await.unwrap() else { return false };
        assert_eq!(self.before[&job.id].state, JobState::Queued);
        assert!(job.needs.iter().all(|need| self.before[need].state == JobState::Succeeded), "{:?}", job.needs);
        self.running.push(Attempt { job_id: job.id, token_hash });
        true
    }

    fn take(&mut self, at: usize) -> Option<Attempt> {
        if self.running.is_empty() {
            return None;
        }
        let attempt = self.running.swap_remove(at % self.running.len());
        self.over.push(attempt.clone());
        Some(attempt)
    }

    /// Handled as a worker's result: a job that was cancelled ends cancelled.
    async fn succeed(&self, attempt: &Attempt) {
        if self.store.job(&attempt.job_id).await.unwrap().cancel_requested {
            self.store.end_attempt(attempt, &AttemptEnd::Stopped).await.unwrap();
            return;
        }
        let mut tx = self.store.write().await.unwrap();
        let job = super::super::attempt::running(&mut tx, attempt).await.unwrap().unwrap();
        queue::advance(&mut tx, &job, JobState::Succeeded, "done", "").await.unwrap();
        self.store.commit(tx).await.unwrap();
    }

    /// Compares each job with its earlier state.
    async fn check(&mut self) {
        for id in self.ids.clone() {
            let now = self.store.job(&id).await.unwrap();
            let before = &self.before[&id];
            assert!(
                now.state == before.state || before.state.may_become(now.state),
                "{:?} became {:?}",
                before.state,
                now.state
            );
            assert!(now.attempt <= now.max_attempts, "attempt {} of {}", now.attempt, now.max_attempts);
            assert_eq!(now.state.ended(), now.ended_at.is_some());
            assert_eq!(now.state == JobState::Running, self.running.iter().any(|attempt| attempt.job_id == id));
            if before.state.ended() {
                assert_eq!(&now, before, "an ended job changed");
            }
            self.before.insert(id, now);
        }
        for job in self.before.values().filter(|job| job.state == JobState::Queued) {
            let lost = |state| matches!(state, JobState::Failed | JobState::Cancelled);
            assert!(!job.needs.iter().any(|need| lost(self.before[need].state)), "a job waits for a lost result");
        }
    }

    /// Once all workers finish their work, every job ends.
    async fn drain(&mut self) {
        loop {
            while let Some(attempt) = self.take(0) {
                self.succeed(&attempt).await;
                self.check().await;
            }
            if !self.claim().await {
                break;
            }
            self.check().await;
        }
        assert!(self.before.values().all(|job| job.state.ended()), "{:?}", self.before);
    }
}

#[test]
fn jobs_keep_to_their_state_machine_under_any_events() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let (_dir, store) = runtime.block_on(testing::store());
    let task = runtime.block_on(testing::task(&store));
    let config = ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() };
    proptest!(config, |(wanted in jobs(), events in proptest::collection::vec(event(), 1..25))| {
        runtime.block_on(async {
            let mut course = Course::new(store.clone(), &task, wanted).await;
            for event in events {
                course.happen(event).await;
            }
            course.drain().await;
        });
    });
}
