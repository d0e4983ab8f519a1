//! What the demo does, stage by stage, each timed.

use std::collections::HashMap;
use std::path::PathBuf;
use std::time::Instant;

use gleaner_client::{Client, DrivePlan, PushItem, UploadLabel, read_labels, spec};
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::train_spec::Data;
use gleaner_proto::v1::{
    CreateDatasetRequest, CreateTaskRequest, DeployRequest, GetEpisodeScoresRequest, GetHistogramRequest, Job, JobSpec,
    PretrainSpec, RoleRule, ScoreSpec, SubmitJobRequest, TrainSpec,
};
use prost_types::Struct;
use serde_json::{Value, json};

use gleaner_sim::{AgentKind, LABELS, RecordedEpisode};

use super::plan::DemoPlan;
use super::report::{Evaluation, RecordedCount, Report, Stage, Threshold};
use crate::cmd::{drive, follow, push, record, scores, what_if};
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::output::terminal_width;
use crate::quality::{Mark, MarkedEpisode, above, select, separations};
use crate::words;

/// What the demo found.
pub(crate) struct Found {
    pub(crate) report: Report,
    pub(crate) episodes: Vec<MarkedEpisode>,
}

/// The demo under way.
pub(crate) struct Stages<'a> {
    context: &'a Context,
    client: Client,
    plan: DemoPlan,
    task: String,
    recordings: PathBuf,
    times: Vec<Stage>,
}

impl<'a> Stages<'a> {
    pub(crate) fn new(context: &'a Context, client: Client, plan: DemoPlan, recordings: PathBuf) -> Self {
        let task = plan.task().to_string();
        Self { context, client, plan, task, recordings, times: Vec::new() }
    }

    pub(crate) async fn run(mut self) -> Result<Found> {
        let recorded = self.record().await?;
        let episode_ids = self.push().await?;
        let encoder = self.pretrain().await?;
        let run = self.score(&encoder).await?;
        let histogram = self.histogram(&run).await?;
        let episodes = self.marked_episodes(&run, &recorded, &episode_ids).await?;
        let dataset = self.dataset(&run).await?;
        let [base, gleaned] = self.train([Data::ExpertsOf(encoder), Data::DatasetId(dataset)]).await?;
        let policies = vec![
            self.evaluate("experts", "experts alone (SSDF-base)", base).await?,
            self.evaluate("gleaned", "experts and gleaned segments", gleaned).await?,
        ];
        let report = Report {
            recorded: recorded_counts(&recorded),
            separation: separations(&episodes),
            thresholds: self.plan.betas.iter().map(|&beta| threshold(&episodes, beta)).collect(),
            histogram,
            policies,
            stages: self.times,
            plan: self.plan,
        };
        Ok(Found { report, episodes })
    }

    // Notes how long a stage took, for the report and for who waits.
    fn done(&mut self, stage: &str, began: Instant, detail: String) {
        let took = began.elapsed();
        self.context.output.note(format_args!("{stage:<18} {:>8}  {detail}", words::duration(took)));
        self.times.push(Stage { stage: stage.to_owned(), seconds: took.as_secs_f64(), detail });
    }

    async fn record(&mut self) -> Result<Vec<RecordedEpisode>> {
        let began = Instant::now();
        let recorded = record::record(self.context, &self.recordings, self.plan.record_set()?).await?;
        let steps: usize = recorded.iter().map(|episode| episode.steps).sum();
        self.done("record", began, format!("{} episodes, {steps} steps", recorded.len()));
        Ok(recorded)
    }

    // Returns each recording's episode by file name.
    async fn push(&mut self) -> Result<HashMap<String, String>> {
        let began = Instant::now();
        let task_spec = gleaner_sim::task_spec(self.plan.task(), &self.plan.config());
        let request = CreateTaskRequest { spec: Some(spec::to_proto(&task_spec)) };
        self.client.tasks().create_task(request).await?;
        let item = |file: gleaner_client::LabelledFile| PushItem {
            path: file.path,
            task: self.task.clone(),
            label: UploadLabel { outcome: file.outcome, cohort: file.cohort, author: "demo".into() },
        };
        let items = read_labels(&self.recordings.join(LABELS))?.into_iter().map(item).collect();
        let pushed = push::push(self.context, &self.client, items, 4).await;
        if let Some((item, error)) = pushed.failures().next() {
            return Err(Failure::told(format!("{} was not taken: {error}", item.path.display())));
        }
        let ids = pushed.uploaded().map(|uploaded| (uploaded.episode.file_name.clone(), uploaded.episode.id.clone()));
        let ids = ids.collect();
        let rate = words::rate(pushed.sent_bytes(), pushed.wall);
        let megabytes = words::megabytes(pushed.sent_bytes());
        self.done("push", began, format!("{megabytes:.1} MB at {rate:.1} MB/s, each inspected"));
        Ok(ids)
    }

    async fn job(&self, spec: Spec) -> Result<Job> {
        let request = SubmitJobRequest {
            task: self.task.clone(),
            spec: Some(JobSpec { spec: Some(spec) }),
            ..SubmitJobRequest::default()
        };
        let job = present(self.client.jobs().submit_job(request).await?.into_inner().job, "a job")?;
        follow::to_success(self.context, &self.client, &job.id).await
    }

    async fn pretrain(&mut self) -> Result<String> {
        let began = Instant::now();
        let job = self
            .job(Spec::Pretrain(PretrainSpec {
                // By who recorded: what an imperfect agent did is imperfect even where it succeeded.
                rule: Some(RoleRule {
                    expert_cohorts: vec![AgentKind::Expert.name().into()],
                    imperfect_cohorts: DemoPlan::imperfect_kinds().map(|kind| kind.name().into()).collect(),
                    ..RoleRule::default()
                }),
                settings: settings(json!({
                    "steps": self.plan.pretrain_steps, "batch": self.plan.pretrain_batch,
                    "seed": self.plan.train_seed,
                })),
                ..PretrainSpec::default()
            }))
            .await?;
        let memory = words::megabytes(job.peak_memory_bytes);
        self.done("pretrain", began, format!("{} steps, peak {memory:.0} MB", self.plan.pretrain_steps));
        Ok(job.result_id)
    }

    async fn score(&mut self, encoder: &str) -> Result<String> {
        let began = Instant::now();
        let job = self
            .job(Spec::Score(ScoreSpec {
                encoder_id: encoder.to_owned(),
                settings: settings(json!({"normaliser": self.plan.normaliser})),
                ..ScoreSpec::default()
            }))
            .await?;
        self.done("score", began, job.message);
        Ok(job.result_id)
    }

    async fn histogram(&mut self, run: &str) -> Result<Vec<u64>> {
        let request = GetHistogramRequest { score_run_id: run.to_owned(), bins: 20, betas: self.plan.betas.clone() };
        let reply = self.client.scores().get_histogram(request).await?.into_inner();
        self.context.output.note(scores::histogram(&reply, terminal_width()));
        Ok(reply.counts)
    }

    async fn marked_episodes(
        &mut self,
        run: &str,
        recorded: &[RecordedEpisode],
        episode_ids: &HashMap<String, String>,
    ) -> Result<Vec<MarkedEpisode>> {
        let began = Instant::now();
        let mut marked = Vec::new();
        for episode in recorded.iter().filter(|episode| episode.agent.kind() != AgentKind::Expert) {
            let file_name = episode.path.file_name().map(|name| name.to_string_lossy().into_owned());
            let id = present(file_name.and_then(|name| episode_ids.get(&name)), "an episode that was pushed")?;
            let request = GetEpisodeScoresRequest { score_run_id: run.to_owned(), episode_id: id.clone() };
            let scores = self.client.scores().get_episode_scores(request).await?.into_inner().scores;
            let scores = present(scores, "scores")?;
            marked.push(MarkedEpisode {
                id: id.clone(),
                cohort: episode.cohort.clone(),
                success: episode.success,
                mark: Mark::from(episode),
                q: scores.q,
                w: scores.w,
            });
        }
        self.done("compare with mark", began, format!("{} imperfect episodes", marked.len()));
        Ok(marked)
    }

    async fn dataset(&mut self, run: &str) -> Result<String> {
        let began = Instant::now();
        let request =
            CreateDatasetRequest { score_run_id: run.to_owned(), selection: Some(what_if::beta(self.plan.beta)) };
        let reply = self.client.datasets().create_dataset(request).await?.into_inner();
        let dataset = present(reply.dataset, "a dataset")?;
        let (kept, experts) = (dataset.kept_segments.unwrap_or(0), dataset.expert_segments.unwrap_or(0));
        self.done("dataset", began, format!("{kept} kept and {experts} expert segments"));
        Ok(dataset.id)
    }

    // Both policies side by side, each by a worker of its own.
    async fn train(&mut self, data: [Data; 2]) -> Result<[String; 2]> {
        let began = Instant::now();
        let [base, gleaned] = data.map(|data| {
            self.job(Spec::Train(TrainSpec {
                data: Some(data),
                settings: settings(json!({
                    "steps": self.plan.train_steps, "batch": self.plan.train_batch, "lambda": self.plan.lambda,
                    "seed": self.plan.train_seed,
                })),
            }))
        });
        let (base, gleaned) = tokio::try_join!(base, gleaned)?;
        let [of_base, of_gleaned] =
            [&base, &gleaned].map(|job| words::between(job.start_time.as_ref(), job.end_time.as_ref()));
        let steps = self.plan.train_steps;
        self.done("train both", began, format!("{steps} steps each, on experts {of_base}, with gleaned {of_gleaned}"));
        Ok([base.result_id, gleaned.result_id])
    }

    async fn evaluate(&mut self, name: &str, trained_on: &str, policy_id: String) -> Result<Evaluation> {
        let began = Instant::now();
        let deployment = format!("{}@{name}", self.task);
        let request = DeployRequest { name: deployment.clone(), policy_id, ..DeployRequest::default() };
        self.client.policies().deploy(request).await?;
        let plan = DrivePlan {
            deployment,
            task: self.plan.task(),
            config: self.plan.config(),
            episodes: self.plan.evaluation_episodes,
            seed: self.plan.evaluation_seed,
            sessions: self.plan.sessions,
            real_time: None,
            record: None,
        };
        let driven = drive::drive(self.context, &self.client, &plan).await?;
        let success_rate = words::success_rate(&driven);
        self.done(&format!("evaluate {name}"), began, success_rate.clone());
        Ok(Evaluation { trained_on: trained_on.to_owned(), result: drive::document(&plan, &driven), success_rate })
    }
}

/// Settings of a job; what is left out takes the server's default.
fn settings(given: Value) -> Option<Struct> {
    given.as_object().map(gleaner_core::proto::to_struct)
}

fn threshold(episodes: &[MarkedEpisode], beta: f64) -> Threshold {
    Threshold { beta, selected: select(episodes, above(beta)) }
}

fn recorded_counts(recorded: &[RecordedEpisode]) -> Vec<RecordedCount> {
    let of = |kind: AgentKind| {
        let episodes: Vec<_> = recorded.iter().filter(|episode| episode.agent.kind() == kind).collect();
        RecordedCount {
            agent: kind.name().to_owned(),
            episodes: episodes.len(),
            steps: episodes.iter().map(|episode| episode.steps).sum(),
            successes: episodes.iter().filter(|episode| episode.success).count(),
        }
    };
    AgentKind::ALL.into_iter().map(of).filter(|count| count.episodes > 0).collect()
}
