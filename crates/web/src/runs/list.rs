//! A task's score runs, and the policies trained on them.

use std::collections::HashMap;

use axum::{extract::Path, response::IntoResponse as _};
use gleaner_core::{
    Result, Values, Words as _,
    dataset::Dataset,
    id::{DatasetId, SnapshotId},
    job::{Job, JobKind, JobState},
    order::JobFilter,
    policy::{Policy, PolicyOrigin},
    score::{Origin, ScoreRun},
    snapshot::Snapshot,
    task::Task,
};
use maud::{Markup, html};
use serde::Deserialize;
use serde_json::json;

use crate::{
    Backend,
    jobs::state,
    link,
    page_request::PageRequest,
    refusal::Answer,
    sheet::{self, Format, Sheet},
    shell::{self, Head, Tab},
    text,
};

/// The number of pending jobs shown.
const COMING: u32 = 50;

#[derive(Deserialize)]
struct Parameters {
    #[serde(default)]
    format: Format,
    #[serde(default)]
    table: Table,
}

/// The table requested by a program.
#[derive(Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Table {
    #[default]
    Runs,
    Policies,
}

/// The data of the page.
struct RunsOfTask {
    runs: Vec<ScoreRun>,
    snapshots: HashMap<SnapshotId, Snapshot>,
    datasets: Vec<Dataset>,
    coming: Vec<Job>,
    policies: Vec<Policy>,
}

pub(crate) async fn show(request: PageRequest, Path(task): Path<String>) -> Answer {
    let Parameters { format, table } = request.parameters()?;
    let backend = request.backend();
    let task = backend.task(&task).await?;
    let made = RunsOfTask::of(backend, &task).await?;
    if format != Format::Html {
        let sheet = if table == Table::Policies { made.policy_sheet(&task) } else { made.run_sheet(&task) };
        return Ok(sheet.answer(format)?);
    }
    let name = task.spec.name.as_str();
    let body = html! {
        h1 { "Score runs" }
        p.lead { "Score runs of " (name) ", newest first. Open a run to choose a threshold." }
        @if made.runs.is_empty() && made.coming.is_empty() {
            p.panel.empty { "No runs yet. Create one with " code { "gleaner score" } "." }
        } @else {
            (made.run_table())
            (sheet::links(&request))
        }
        h2 { "Policies" }
        @if made.policies.is_empty() {
            p.panel.empty { "No policies yet." }
        } @else {
            (made.policy_table())
            p.formats { "This table as "
                a href=(format!("/tasks/{name}/runs?table=policies&format=json")) { "JSON" } " or "
                a href=(format!("/tasks/{name}/runs?table=policies&format=csv")) { "CSV" } }
        }
    };
    let head = Head { title: "Score runs", tab: Tab::Runs, task: Some(name), script: None };
    Ok(shell::page(&request, &head, &body).into_response())
}

impl RunsOfTask {
    async fn of(backend: &dyn Backend, task: &Task) -> Result<Self> {
        let runs = backend.score_runs(&task.id).await?;
        let mut coming = Vec::new();
        for state in [JobState::Running, JobState::Queued] {
            let filter = JobFilter { task_id: Some(task.id.clone()), state: Some(state), kind: Some(JobKind::Score) };
            coming.extend(backend.jobs(&filter, None, COMING).await?.0);
        }
        let snapshots = backend.snapshots(&task.id).await?;
        Ok(Self {
            runs,
            snapshots: snapshots.into_iter().map(|snapshot| (snapshot.id.clone(), snapshot)).collect(),
            datasets: backend.datasets(&task.id).await?,
            coming,
            policies: backend.policies(&task.id).await?,
        })
    }

    fn datasets_of<'a>(&'a self, run: &'a ScoreRun) -> impl Iterator<Item = &'a Dataset> {
        self.datasets.iter().filter(|dataset| dataset.score_run_id == run.id)
    }

    fn selection_of(&self, id: &DatasetId) -> Option<String> {
        self.datasets.iter().find(|dataset| dataset.id == *id).map(|dataset| link::selection(dataset.selection))
    }

    fn run_table(&self) -> Markup {
        html! {
            div.scroll { table {
                thead { tr {
                    th { "Run" } th { "Created (UTC)" } th.number { "Experts" } th.number { "Imperfect" } th { "Scored by" }
                    th { "Normaliser" } th { "Encoder" } th { "Datasets" }
                } }
                tbody {
                    @for job in &self.coming { tr {
                        td { (link::brief(&job.result_id, Some(&format!("/jobs/{}", job.id)))) }
                        td { (state(job)) }
                        td.soft colspan="6" {
                            @if job.total > 0 { progress value=(job.done) max=(job.total) aria-label="Progress" {} " " }
                            (job.message)
                        }
                    } }
                    @for run in &self.runs { (self.run_row(run)) }
                }
            } }
        }
    }

    fn run_row(&self, run: &ScoreRun) -> Markup {
        let snapshot = self.snapshots.get(&run.snapshot_id);
        html! { tr {
            td { (link::brief(run.id.as_str(), Some(&format!("/runs/{}", run.id)))) }
            td.when { (text::time(run.created_at)) }
            td.number { @if let Some(snapshot) = snapshot { (text::count(snapshot.expert_episodes)) } }
            td.number { @if let Some(snapshot) = snapshot { (text::count(snapshot.imperfect_episodes)) } }
            td.when { (run.origin.scorer()) }
            td { (normaliser(run)) }
            td { @if let Some(encoder) = run.origin.encoder_id() {
                (link::brief(encoder.as_str(), Some(&format!("/encoders/{encoder}"))))
            } }
            td { @for dataset in self.datasets_of(run) {
                a.tag.kept href=(format!("/datasets/{}", dataset.id)) { (link::selection(dataset.selection)) } " "
            } }
        } }
    }

    fn policy_table(&self) -> Markup {
        html! {
            div.scroll { table {
                thead { tr { th { "Policy" } th { "Created (UTC)" } th { "Kind" } th { "Trained on" } th { "Job" } } }
                tbody { @for policy in &self.policies { tr {
                    td { (link::brief(policy.id.as_str(), Some(&format!("/policies/{}", policy.id)))) }
                    td.when { (text::time(policy.created_at)) }
                    td { (policy.kind) }
                    td { (self.trained_on(policy)) }
                    td { @if let Some(job) = policy.job_id() {
                        (link::brief(job.as_str(), Some(&format!("/jobs/{job}"))))
                    } }
                } } }
            } }
        }
    }

    /// The data of a policy; of one that another server runs, its address.
    fn trained_on(&self, policy: &Policy) -> Markup {
        let training = match &policy.origin {
            PolicyOrigin::Trained(training) => training,
            PolicyOrigin::Remote(remote) => return html! { "elsewhere, runs on " (remote.address) },
        };
        html! {
            "experts" @if let Some(id) = &training.dataset_id {
                " and " a.tag.kept href=(format!("/datasets/{id}")) {
                    (self.selection_of(id).unwrap_or_else(|| "a dataset".to_owned()))
                }
            }
        }
    }

    fn run_sheet(&self, task: &Task) -> Sheet {
        let row = |run: &ScoreRun| {
            let snapshot = self.snapshots.get(&run.snapshot_id);
            let datasets: Vec<&str> = self.datasets_of(run).map(|dataset| dataset.id.as_str()).collect();
            vec![
                json!(run.id),
                json!(text::stamp(run.created_at)),
                json!(run.snapshot_id),
                json!(snapshot.map(|snapshot| snapshot.expert_episodes)),
                json!(snapshot.map(|snapshot| snapshot.imperfect_episodes)),
                json!(run.origin.scorer()),
                json!(serde_json::Value::Object(scorer_settings(run)).to_string()),
                json!(normaliser(run)),
                json!(run.origin.encoder_id()),
                json!(run.origin.job_id()),
                json!(datasets.join(" ")),
            ]
        };
        let columns = &[
            "score_run_id",
            "created_at",
            "snapshot_id",
            "expert_episodes",
            "imperfect_episodes",
            "scorer",
            "settings",
            "normaliser",
            "encoder_id",
            "job_id",
            "dataset_ids",
        ];
        Sheet { name: format!("{}-runs", task.spec.name), columns, rows: self.runs.iter().map(row).collect() }
    }

    fn policy_sheet(&self, task: &Task) -> Sheet {
        let row = |policy: &Policy| {
            let Policy { id, kind, created_at, .. } = policy;
            let training = policy.training();
            vec![
                json!(id),
                json!(text::stamp(*created_at)),
                json!(kind),
                json!(training.and_then(|training| training.encoder_id.as_ref())),
                json!(training.and_then(|training| training.dataset_id.as_ref())),
                json!(policy.job_id()),
                json!(policy.remote().map(|remote| remote.address.as_str())),
            ]
        };
        let columns = &["policy_id", "created_at", "kind", "encoder_id", "dataset_id", "job_id", "address"];
        Sheet { name: format!("{}-policies", task.spec.name), columns, rows: self.policies.iter().map(row).collect() }
    }
}

/// The word of the run's normaliser; empty for an import, whose scores came as q.
fn normaliser(run: &ScoreRun) -> &'static str {
    match &run.origin {
        Origin::Job { spec, .. } => spec.normaliser.as_str(),
        Origin::Import { .. } => "",
    }
}

/// The settings of the run's scorer; of an import, its source.
fn scorer_settings(run: &ScoreRun) -> Values {
    match &run.origin {
        Origin::Job { spec, .. } => spec.scorer.settings.clone(),
        Origin::Import { source, .. } => Values::from_iter([("source".to_owned(), source.as_str().into())]),
    }
}
