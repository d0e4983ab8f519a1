//! The generated clients over one connection, and the calls that many tests make.

use gleaner_proto::v1::{
    dataset_service_client::DatasetServiceClient, episode_service_client::EpisodeServiceClient,
    job_service_client::JobServiceClient, policy_service_client::PolicyServiceClient,
    schedule_service_client::ScheduleServiceClient, score_service_client::ScoreServiceClient,
    snapshot_service_client::SnapshotServiceClient, task_service_client::TaskServiceClient, *,
};
use tonic::{Status, transport::Channel};

use super::{lab, server::TestServer, wait::within};

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

    /// Watches a job until it passes; returns it as it was then.
    pub async fn watch_until(&mut self, job_id: &str, mut passes: impl FnMut(&Job) -> bool) -> Job {
        let request = WatchJobRequest { job_id: job_id.to_owned() };
        let watching = async {
            let mut events = self.jobs.watch_job(request).await.unwrap().into_inner();
            while let Some(event) = events.message().await.unwrap() {
                let job = event.job.unwrap();
                if passes(&job) {
                    return job;
                }
            }
            panic!("the stream of the job ended before the job passed");
        };
        within("the job passes", watching).await
    }

    /// Watches a job to its end.
    pub async fn watch(&mut self, job_id: &str) -> Job {
        self.watch_until(job_id, |job| gleaner_client::has_ended(job.state())).await
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

    /// The scores of an episode.
    pub async fn episode_scores(&mut self, run: &str, episode: &str) -> EpisodeScores {
        let request = GetEpisodeScoresRequest { score_run_id: run.to_owned(), episode_id: episode.to_owned() };
        self.scores.get_episode_scores(request).await.unwrap().into_inner().scores.unwrap()
    }

    /// Pretrains an encoder and trains a policy on its experts, for a few steps each; returns both ids.
    pub async fn train_policy(&mut self, steps: u32) -> (String, String) {
        let encoder = self.succeed(lab::TASK, lab::pretrain(steps)).await.result_id;
        let train = lab::train(train_spec::Data::ExpertsOf(encoder.clone()), steps);
        let policy = self.succeed(lab::TASK, train).await.result_id;
        (encoder, policy)
    }

    /// The evaluation of this id.
    pub async fn evaluation(&mut self, id: &str) -> Evaluation {
        let request = GetEvaluationRequest { evaluation_id: id.to_owned() };
        self.policies.get_evaluation(request).await.unwrap().into_inner().evaluation.unwrap()
    }

    /// Deploys a policy under a name.
    pub async fn deploy(&mut self, name: &str, policy: &str) {
        let request = DeployRequest { name: name.to_owned(), policy_id: policy.to_owned(), ..Default::default() };
        self.policies.deploy(request).await.unwrap();
    }

    /// The policies of the task, newest first.
    pub async fn policies(&mut self) -> Vec<Policy> {
        let request = ListPoliciesRequest { task: lab::TASK.into(), ..ListPoliciesRequest::default() };
        self.policies.list_policies(request).await.unwrap().into_inner().policies
    }

    /// The episodes of the task.
    pub async fn episodes(&mut self) -> Vec<Episode> {
        let request = ListEpisodesRequest { task: lab::TASK.into(), ..ListEpisodesRequest::default() };
        self.episodes.list_episodes(request).await.unwrap().into_inner().episodes
    }

    /// The ids of the task's episodes, sorted.
    pub async fn episode_ids(&mut self) -> Vec<String> {
        let mut ids: Vec<String> = self.episodes().await.into_iter().map(|episode| episode.id).collect();
        ids.sort();
        ids
    }

    /// The recording of an episode.
    pub async fn download(&mut self, episode: &str) -> Vec<u8> {
        self.try_download(episode).await.unwrap()
    }

    /// Like [`Self::download`], with the error of the server.
    pub async fn try_download(&mut self, episode: &str) -> Result<Vec<u8>, Status> {
        let request = DownloadEpisodeRequest { episode_id: episode.to_owned(), accept_url: false };
        let mut chunks = self.episodes.download_episode(request).await?.into_inner();
        let mut bytes = Vec::new();
        while let Some(chunk) = chunks.message().await? {
            bytes.extend_from_slice(&chunk.data);
        }
        Ok(bytes)
    }

    /// Labels an episode.
    pub async fn label(&mut self, episode: &str, outcome: Outcome) -> Result<(), Status> {
        let (episode_ids, outcome) = (vec![episode.to_owned()], outcome.into());
        let request = LabelEpisodesRequest { episode_ids, outcome, ..Default::default() };
        self.episodes.label_episodes(request).await.map(|_| ())
    }

    /// Moves an episode to the trash.
    pub async fn delete(&mut self, episode: &str) {
        let request = DeleteEpisodesRequest { episode_ids: vec![episode.to_owned()], force: false };
        self.episodes.delete_episodes(request).await.unwrap();
    }

    /// The number of stored bytes of an upload.
    pub async fn committed_size(&mut self, upload: &str) -> Result<u64, Status> {
        let request = GetUploadRequest { upload_id: upload.to_owned() };
        Ok(self.episodes.get_upload(request).await?.into_inner().committed_size)
    }
}
