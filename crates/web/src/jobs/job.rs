//! One job: its progress, its inputs, its result and its spec.

use axum::{extract::Path, response::IntoResponse as _};
use gleaner_core::{
    Result,
    error::Kind,
    id::{EvaluationId, ExportId, JobId},
    job::{Job, JobKind, JobState},
};
use maud::{Markup, html};

use super::{course, spec};
use crate::{
    Backend, artifacts, link,
    page::Page,
    page_request::PageRequest,
    refusal::Answer,
    shell::{self, Head, Tab},
    text,
};

pub(crate) async fn show(request: PageRequest, Path(id): Path<String>) -> Answer {
    let backend = request.backend();
    let job = backend.job(&JobId::parse("id", &id)?).await?;
    let task = backend.task_by_id(&job.task_id).await?;
    let name = match job.spec.kind() {
        JobKind::Pretrain => "Pretrain",
        JobKind::Score => "Score",
        JobKind::Train => "Train",
        JobKind::Export => "Export",
        JobKind::Evaluate => "Evaluate",
    };
    let body = html! {
        div.row.title {
            h1 { (name) " job " (link::tail(job.id.as_str())) }
            (actions(&request, &job))
        }
        (course::course(backend, &job).await?)
        (made_of(backend, &job).await?)
        (waits(backend, &job).await?)
        h2 { "Lineage" }
        (artifacts::of_job(backend, &job).await?)
        h2 { "Settings" }
        (spec::table(&job.spec)?)
        h2 { "Record" }
        (record(&job))
    };
    let head = Head { title: name, tab: Tab::Jobs, task: Some(&task.spec.name), script: Some("job.js") };
    Ok(shell::page(&request, &head, &body).into_response())
}

/// The actions on it that the caller may take now.
fn actions(request: &PageRequest, job: &Job) -> Markup {
    let form = |to: &str, class: &str, (name, hint): (&str, &str)| {
        html! {
            form method="post" action=(format!("/jobs/{}/{to}", job.id)) {
                input type="hidden" name="proof" value=(request.proof);
                button class=(class) type="submit" title=(hint) { (name) }
            }
        }
    };
    html! {
        @match job.state {
            JobState::Queued | JobState::Running => {
                @if request.may(Page::CancelJob) && !job.cancel_requested {
                    // Hours of work may be lost, so a second click confirms.
                    details.confirm {
                        summary.button.danger { "Cancel" }
                        p.soft { "Cancels the job and the jobs that wait for it. A retry starts from the beginning." }
                        (form("cancel", "danger", ("Cancel the job", "Cancels the job and the jobs that wait for it")))
                    }
                }
            },
            JobState::Failed | JobState::Cancelled => {
                @if request.may(Page::RetryJob) { (form("retry", "primary", ("Retry", "Submits the job again with the same settings, and the jobs that waited for it"))) }
            },
            JobState::Succeeded => {},
        }
    }
}

/// Its result, once it exists.
async fn made_of(backend: &dyn Backend, job: &Job) -> Result<Markup> {
    if job.state != JobState::Succeeded {
        return Ok(html! {});
    }
    let result = job.result_id.as_str();
    let made = match job.spec.kind() {
        JobKind::Pretrain => html! { "Encoder " (link::whole(result)) },
        JobKind::Score => html! { "Score run " (link::whole(result)) },
        JobKind::Train => html! { "Policy " (link::whole(result)) },
        JobKind::Evaluate => {
            let evaluation = backend.evaluation(&EvaluationId::parse("result_id", result)?).await?;
            let success = evaluation.success();
            html! { "Succeeded in " b { (artifacts::rate(&success)) } " of " (text::counted(success.episodes.into(), "attempt"))
            ", policy " (link::whole(evaluation.policy_id.as_str())) }
        }
        JobKind::Export => {
            let files = match backend.export_files(&ExportId::parse("result_id", result)?).await {
                Err(error) if error.kind() == Kind::Precondition => {
                    return Ok(html! { h2 { "Result" } p.panel { (error) } });
                }
                files => files?,
            };
            let bytes = files.iter().map(|file| file.size_bytes).sum();
            html! { (text::counted(files.len() as u64, "file")) ", " (text::bytes(bytes)) ": " code { "gleaner export" }
            " downloads " span.id { (result) } }
        }
    };
    Ok(html! { h2 { "Result" } p.panel { (made) } })
}

/// The jobs it waits or waited for.
async fn waits(backend: &dyn Backend, job: &Job) -> Result<Markup> {
    if job.needs.is_empty() {
        return Ok(html! {});
    }
    let mut needed = Vec::with_capacity(job.needs.len());
    for id in &job.needs {
        needed.push(backend.job(id).await?);
    }
    Ok(html! {
        h2 { @if job.state == JobState::Queued { "Waiting for" } @else { "Waited for" } }
        ul.panel.waits { @for job in &needed {
            li { (course::state(job)) " " (job.spec.kind().as_str()) " " (link::whole(job.id.as_str())) }
        } }
    })
}

fn record(job: &Job) -> Markup {
    html! {
        dl.facts.panel {
            dt { "Job" } dd.id { (job.id) }
            dt { "Result" } dd.id { (job.result_id) }
            dt { "Priority" } dd { (job.priority) }
            @if !job.key.is_empty() { dt { "Key" } dd { (job.key) } }
            @if !job.engine_options.is_empty() { dt { "Engine options" } dd { code { (job.engine_options) } } }
            @if let Some(ended) = job.ended_at { dt { "Ended" } dd { (text::time(ended)) " UTC" } }
        }
    }
}
