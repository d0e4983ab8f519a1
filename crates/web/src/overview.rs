//! The overview page: tasks with their episodes, the latest jobs, live sessions and free disk space.

use axum::response::IntoResponse as _;
use gleaner_core::{
    curation::{TaskOverview, Totals},
    job::Job,
    order::JobFilter,
    task::OutcomeCounts,
};
use maud::{Markup, html};
use serde::Deserialize;
use serde_json::json;

use super::{
    Backend,
    backend::Disk,
    jobs,
    page_request::PageRequest,
    paging,
    refusal::Answer,
    sheet::{self, Format, Sheet},
    shell::{self, Head, Tab},
    text,
};

/// The number of jobs shown.
const JOBS: u32 = 8;

/// Tasks on one page.
const PER_PAGE: usize = 48;

/// The query; a form sends an unset field empty.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Parameters {
    text: String,
    page: String,
    format: Format,
}

pub(super) async fn show(request: PageRequest) -> Answer {
    let parameters: Parameters = request.parameters()?;
    let (text, page) = (parameters.text.trim(), paging::parse(&parameters.page)?);
    let backend = request.backend();
    if parameters.format != Format::Html {
        return Ok(sheet(backend.overview(text, 0, usize::MAX).await?).answer(parameters.format)?);
    }
    let totals = backend.totals().await?;
    let found = if text.is_empty() { totals.tasks } else { backend.count_tasks(text).await? };
    let pages = paging::within(page, usize::try_from(found).unwrap_or(usize::MAX), PER_PAGE);
    let tasks = backend.overview(text, (pages.0 - 1) * PER_PAGE, PER_PAGE).await?;
    let (jobs, _) = backend.jobs(&JobFilter::default(), None, JOBS).await?;
    let disk = backend.disk().await?;
    let body = html! {
        h1 { "Overview" }
        (figures(backend, &totals, &disk))
        h2 { "Tasks" }
        @if totals.tasks == 0 {
            p.panel.empty { "No tasks yet. Create one with " code { "gleaner task create task.toml" } ", then "
                code { "gleaner push" } "." }
        } @else {
            @if pages.1 > 1 || !text.is_empty() { (search(text, found)) }
            @if tasks.is_empty() {
                p.panel.empty { "No tasks have this text in their name. " a href="/" { "Show all" } }
            } @else {
                div.cards { @for task in &tasks { (card(task)) } }
                (sheet::links(&request))
                (paging::links(&request, "Pages of tasks", pages))
            }
        }
        h2 { "Latest jobs" }
        @if jobs.is_empty() {
            p.panel.empty { "No jobs yet." }
        } @else {
            div.scroll { table {
                thead { tr { th { "State" } th { "Kind" } th { "Job" } th { "Summary" } th.number { "Submitted (UTC)" } } }
                tbody { @for job in &jobs { (job_row(job)) } }
            } }
            p.formats { a href="/jobs" { "All jobs" } }
        }
    };
    let head = Head { title: "Overview", tab: Tab::Overview, task: None, script: None };
    Ok(shell::page(&request, &head, &body).into_response())
}

fn figures(backend: &dyn Backend, totals: &Totals, disk: &Disk) -> Markup {
    let sessions = u64::try_from(backend.live().len()).unwrap_or(u64::MAX);
    html! {
        dl.figures {
            div { dt { "Tasks" } dd { (text::count(totals.tasks)) } }
            div { dt { "Episodes" } dd { (text::count(totals.episodes)) } }
            div { dt { "Recorded" } dd { (text::seconds(totals.hours * 3600.0)) } }
            div { dt { "Size of recordings" } dd { (text::bytes(totals.bytes)) } }
            div { dt { "Live sessions" } dd { a href="/deployments" { (text::count(sessions)) } } }
            div { dt { "Free disk space" } dd { (text::bytes(disk.free)) " " small { "of " (text::bytes(disk.size)) } } }
        }
    }
}

/// The search form, for tasks on several pages.
fn search(text: &str, found: u64) -> Markup {
    html! {
        form.filters method="get" action="/" role="search" aria-label="Filter tasks" {
            label { "Name" input type="search" name="text" value=(text) maxlength="128"; }
            button.primary type="submit" { "Find" }
            @if !text.is_empty() { a.button href="/" { "Clear" } }
        }
        p.lead { (text::counted(found, "task")) @if !text.is_empty() { " with this text in the name" } ", newest first." }
    }
}

fn card(task: &TaskOverview) -> Markup {
    let name = &task.task.spec.name;
    let OutcomeCounts { success, failure, unknown } = task.outcomes;
    html! {
        section.card {
            h3 { a href=(format!("/tasks/{name}/episodes")) { (name) } }
            p.soft { (text::counted(all(&task.outcomes), "episode")) " · " (text::seconds(task.hours * 3600.0)) " · "
                (text::counted(task.cohorts, "cohort")) }
            (outcomes_bar(&task.outcomes))
            ul.legend {
                @for (outcome, count) in [("success", success), ("failure", failure), ("unknown", unknown)] {
                    li { a href=(format!("/tasks/{name}/episodes?outcome={outcome}")) {
                        svg viewBox="0 0 14 10" aria-hidden="true" { rect.(outcome) width="14" height="10" rx="2" {} }
                        (text::count(count)) " " (outcome)
                    } }
                }
            }
            p { a href=(format!("/tasks/{name}/runs")) { "Score runs" } }
        }
    }
}

/// The outcomes of episodes, as parts of a bar.
#[expect(clippy::cast_precision_loss, reason = "parts of a bar")]
fn outcomes_bar(counts: &OutcomeCounts) -> Markup {
    let whole = all(counts).max(1) as f64;
    let widths = [("success", counts.success), ("failure", counts.failure), ("unknown", counts.unknown)]
        .map(|(class, count)| (class, 100.0 * count as f64 / whole));
    let parts = widths.iter().scan(0.0, |end, &(class, width)| {
        let begin = *end;
        *end += width;
        Some((class, begin, width))
    });
    html! {
        svg.bar viewBox="0 0 100 4" preserveAspectRatio="none" role="img"
            aria-label=(format!("{} succeeded, {} failed, {} unknown", counts.success, counts.failure, counts.unknown)) {
            @for (class, begin, width) in parts {
                rect.(class) x=(format!("{begin:.2}")) width=(format!("{width:.2}")) height="4" {}
            }
        }
    }
}

fn all(counts: &OutcomeCounts) -> u64 {
    counts.success + counts.failure + counts.unknown
}

fn job_row(job: &Job) -> Markup {
    html! {
        tr {
            td { (jobs::state(job)) }
            td { (job.spec.kind().as_str()) }
            td { a.id href=(format!("/jobs/{}", job.id)) { (job.id) } }
            td {
                @if job.total > 0 && !job.state.ended() {
                    progress max=(job.total) value=(job.done) aria-label="done" {} " "
                }
                (if job.error.is_empty() { &job.message } else { &job.error })
            }
            td.number { (text::time(job.created_at)) }
        }
    }
}

fn sheet(tasks: Vec<TaskOverview>) -> Sheet {
    let columns = &["task", "task_id", "success", "failure", "unknown", "hours", "bytes", "cohorts"];
    let row = |task: TaskOverview| {
        let TaskOverview { task, outcomes, hours, bytes, cohorts } = task;
        let OutcomeCounts { success, failure, unknown } = outcomes;
        vec![
            json!(task.spec.name),
            json!(task.id.as_str()),
            json!(success),
            json!(failure),
            json!(unknown),
            json!(hours),
            json!(bytes),
            json!(cohorts),
        ]
    };
    Sheet { name: "tasks".to_owned(), columns, rows: tasks.into_iter().map(row).collect() }
}
