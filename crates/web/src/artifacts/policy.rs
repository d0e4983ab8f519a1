//! One policy: its training data, its success rates and its deployments.

use axum::{extract::Path, response::IntoResponse as _};
use gleaner_core::{
    Error,
    id::PolicyId,
    job::{Job, JobSpec},
    looks::{Look, looks},
    policy::{Deployment, Policy, PolicyOrigin, Training},
    snapshot::Snapshot,
};
use maud::{Markup, html};

use super::{episodes, evaluations, of_job, remote_policy};
use crate::{
    link,
    page_request::PageRequest,
    refusal::Answer,
    settings,
    sheet::{self, Format},
    shell::{self, Head, Tab},
    text,
};

pub(crate) async fn show(request: PageRequest, Path(id): Path<String>) -> Answer {
    let format = sheet::format(&request)?;
    let backend = request.backend();
    let policy = backend.policy(&PolicyId::parse("id", &id)?).await?;
    let tried = backend.evaluations(&policy.id).await?;
    if format != Format::Html {
        return Ok(evaluations::sheet(&policy, &tried).answer(format)?);
    }
    let task = backend.task_by_id(&policy.task_id).await?;
    let mut deployments = backend.deployments(Some(&policy.task_id)).await?;
    let training = match &policy.origin {
        PolicyOrigin::Trained(training) => training,
        PolicyOrigin::Remote(remote) => {
            return remote_policy::show(&request, (&policy, remote), &task, (&tried, &deployments)).await;
        }
    };
    deployments.retain(|deployment| deployment.policy_id() == Some(&policy.id));
    let job = backend.job(&training.job_id).await?;
    let Some(snapshot_id) = job.spec.snapshot_id() else {
        return Err(Error::internal("reading a policy's spec", "its job is not a training job").into());
    };
    let snapshot = backend.snapshot(snapshot_id).await?;
    let trained = looks(&backend.sparse_metrics(&job.id, 1).await?, &task.spec.cameras);
    let evaluated = match tried.iter().find_map(|evaluation| evaluation.job_id.as_ref()) {
        Some(newest) => looks(&backend.sparse_metrics(newest, 1).await?, &task.spec.cameras),
        None => Vec::new(),
    };
    let body = html! {
        h1 { "Policy " (link::tail(policy.id.as_str())) }
        p.lead { (policy.kind) ", trained on experts" @if training.dataset_id.is_some() { " and kept segments" }
            " of " (task.spec.name) ", " (text::time(policy.created_at)) " UTC" }
        h2 { "Evaluations" }
        (evaluations::section(&request, &tried, "gleaner evaluate"))
        @if !trained.is_empty() || !evaluated.is_empty() {
            h2 { "What it looks at" }
            (shares(&trained, &evaluated))
        }
        h2 { "Lineage" }
        (of_job(backend, &job).await?)
        h2 { "Facts" }
        (facts((&policy, training), &job, &snapshot, &deployments))
    };
    let head = Head { title: "Policy", tab: Tab::Runs, task: Some(&task.spec.name), script: None };
    Ok(shell::page(&request, &head, &body).into_response())
}

/// The share of its action that each input explains: in the experts' episodes, and in its own attempts.
fn shares(trained: &[Look], evaluated: &[Look]) -> Markup {
    let further = evaluated.iter().filter(|look| trained.iter().all(|other| other.input != look.input));
    let share = |looks: &[Look], input: &str| {
        let look = looks.iter().find(|look| look.input == input);
        look.map_or_else(|| "-".to_owned(), |look| format!("{:.2}", look.share))
    };
    html! {
        p.soft { "The share of the action that changes when an input is taken from another episode: among the experts it was "
            "trained on, and in the newest evaluation. Near 0: ignored; near 1: nothing else matters. Inputs depend on each "
            "other, so shares need not add up to 1." }
        div.scroll { table {
            thead { tr { th { "Input" } th.number { "Training" } th.number { "Evaluation" } } }
            tbody { @for look in trained.iter().chain(further) { tr {
                td { (look.input) }
                td.number { (share(trained, &look.input)) }
                td.number { (share(evaluated, &look.input)) }
            } } }
        } }
    }
}

fn facts(
    (policy, training): (&Policy, &Training),
    job: &Job,
    snapshot: &Snapshot,
    deployments: &[Deployment],
) -> Markup {
    html! {
        dl.facts.panel {
            dt { "Policy" } dd.id { (policy.id) }
            dt { "Kind" } dd { (policy.kind) }
            @if let JobSpec::Train { spec, .. } = &job.spec {
                dt { "Steps" } dd { (text::count(spec.optim.steps)) }
                dt { "Weighting of kept segments" } dd { (spec.weighting.name) @for (name, value) in settings::rows(&spec.weighting.settings) { ", " (name) " " (value) } }
                dt { "Experts of" } dd { (episodes(snapshot)) " (" (link::whole(snapshot.id.as_str())) ")" }
            }
            @if let Some(dataset) = &training.dataset_id { dt { "Dataset" } dd { (link::whole(dataset.as_str())) } }
            @if let Some(encoder) = &training.encoder_id { dt { "Encoder" } dd { (link::whole(encoder.as_str())) } }
            dt { "Deployed as" }
            dd {
                @if deployments.is_empty() { "not deployed" }
                @for deployment in deployments { a href=(format!("/deployments/{}", deployment.name)) { (deployment.name) } " " }
            }
            dt { "Created by" } dd { (link::whole(training.job_id.as_str())) }
            dt { "Checkpoint (BLAKE3)" } dd.id { (training.checkpoint) }
        }
    }
}
