//! The generated clients over one connection, and the few calls every test makes.

use std::time::Duration;

use gleaner_proto::v1::{
    dataset_service_client::DatasetServiceClient, episode_service_client::EpisodeServiceClient,
    job_service_client::JobServiceClient, policy_service_client::PolicyServiceClient,
    schedule_service_client::ScheduleServiceClient, score_service_client::ScoreServiceClient,
    snapshot_service_client::SnapshotServiceClient, task_service_client::TaskServiceClient, *,
};
use tonic::{Status, transport::Channel};

use crate::server::TestServer;

/// No event in these tests takes longer; a wait beyond it fails the test.
const PATIENCE: Duration = Duration::from_secs(240);

/// Every service of one server.
#[derive(Clone)]
pub struct Api {
    pub tasks: TaskServiceClient<Channel>,
    pub episodes: EpisodeServiceClient<Channel>,
    pub snapshots: SnapshotServiceClient<Channel>,
    pub jobs: JobServiceClient<Channel>,
    pub schedules: ScheduleServiceClient<Channel>,
    pub scores: ScoreServiceClient<Channel>,
    pub datasets: DatasetServiceClient<Channel>,
    pub policies: PolicyServiceClient<Channel>,
}

impl Api {
    pub async fn connect(server: &TestServer) -> Self {
        let channel = Channel::from_shared(server.url().to_owned()).unwrap().connect().await.unwrap();
        let limit = 64 << 20;
        Self {
            tasks: TaskServiceClient::new(channel.clone()),
            episodes: EpisodeServiceClient::new(channel.clone()),
            snapshots: SnapshotServiceClient::new(channel.clone()),
            jobs: JobServiceClient::new(channel.clone()).max_decoding_message_size(limit),
            schedules: ScheduleServiceClient::new(channel.clone()),
            scores: ScoreServiceClient::new(channel.clone()).max_decoding_message_size(limit),
            datasets: DatasetServiceClient::new(channel.clone()).max_decoding_message_size(limit),
            policies: PolicyServiceClient::new(channel).max_encoding_message_size(limit),
        }
    }

    /// Queues a job.
    pub async fn submit(&mut self, task: &str, spec: job_spec::Spec) -> Result<Job, Status> {
        let request = SubmitJobRequest {
            task: task.to_owned(),
            spec: Some(JobSpec { spec: Some(spec) }),
            ..SubmitJobRequest::default()
        };
        Ok(self.jobs.submit_job(request).await?.into_inner().job.unwrap())
    }

    /// Watches a job until `enough` says so; gives back the job as it was then.
    pub async fn watch_until(&mut self, job_id: &str, mut enough: impl FnMut(&Job) -> bool) -> Job {
        let request = WatchJobRequest { job_id: job_id.to_owned() };
        let watching = async {
            let mut events = self.jobs.watch_job(request).await.unwrap().into_inner();
            while let Some(event) = events.message().await.unwrap() {
                let job = event.job.unwrap();
                if enough(&job) {
                    return job;
                }
            }
            panic!("the job ended before what the test waits for");
        };
        tokio::time::timeout(PATIENCE, watching).await.expect("the job took too long")
    }

    /// Watches a job to its end.
    pub async fn watch(&mut self, job_id: &str) -> Job {
        self.watch_until(job_id, |job| {
            matches!(job.state(), JobState::Succeeded | JobState::Failed | JobState::Cancelled)
        })
        .await
    }

    /// Queues a job and watches it succeed.
    pub async fn succeed(&mut self, task: &str, spec: job_spec::Spec) -> Job {
        let job = self.submit(task, spec).await.unwrap();
        let job = self.watch(&job.id).await;
        assert_eq!(job.state(), JobState::Succeeded, "{}: {}", job.id, job.error);
        job
    }

    /// Every value of one metric of a job, by step.
    pub async fn metric(&mut self, job_id: &str, name: &str) -> Vec<(u64, f64)> {
        let request = ListMetricsRequest { job_id: job_id.to_owned() };
        let metrics = self.jobs.list_metrics(request).await.unwrap().into_inner().metrics;
        metrics.into_iter().filter(|metric| metric.name == name).map(|metric| (metric.step, metric.value)).collect()
    }

    /// One episode's scores.
    pub async fn episode_scores(&mut self, run: &str, episode: &str) -> EpisodeScores {
        let request = GetEpisodeScoresRequest { score_run_id: run.to_owned(), episode_id: episode.to_owned() };
        self.scores.get_episode_scores(request).await.unwrap().into_inner().scores.unwrap()
    }
}
