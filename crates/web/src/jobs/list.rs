//! The queue: jobs of all tasks, newest first.

use std::collections::HashMap;

use axum::response::IntoResponse as _;
use gleaner_core::{
    Error, Result,
    id::{EpisodeId, JobId, TaskId},
    job::{Job, JobKind, JobState},
    order::JobFilter,
    time::Millis,
};
use maud::{Markup, html};
use serde::Deserialize;
use serde_json::json;

use super::course::state;
use crate::{
    Backend, link,
    page_request::PageRequest,
    refusal::Answer,
    sheet::{self, Format, Sheet},
    shell::{self, Head, Tab},
    standing::Standings,
    text,
};

/// Jobs of a page, and of one read of the table for programs.
const SIZE: u32 = 100;

/// The query; a form sends an unset field empty.
#[derive(Default, Deserialize)]
struct Parameters {
    #[serde(default)]
    task: String,
    #[serde(default)]
    state: String,
    #[serde(default)]
    kind: String,
    #[serde(default)]
    before: String,
    #[serde(default)]
    format: Format,
}

pub(crate) async fn show(request: PageRequest) -> Answer {
    let parameters: Parameters = request.parameters()?;
    let backend = request.backend();
    let tasks = backend.task_names().await?;
    let before = if parameters.before.is_empty() { None } else { Some(JobId::parse("before", &parameters.before)?) };
    let filter = parameters.filter(backend).await?;
    let names: HashMap<&TaskId, &str> = tasks.iter().map(|(id, name)| (id, name.as_str())).collect();
    if parameters.format != Format::Html {
        return Ok(sheet_of(backend, &filter, before, &names).await?.answer(parameters.format)?);
    }
    let (jobs, next) = backend.jobs(&filter, before.as_ref(), SIZE).await?;
    let named: Vec<EpisodeId> = jobs.iter().flat_map(|job| link::episodes(summary(job))).collect();
    let standings = Standings::of(backend, &named).await?;
    let now = Millis::now();
    let live = jobs.iter().any(|job| !job.state.ended());
    let body = html! {
        h1 { "Jobs" }
        p.lead { "Jobs of all tasks, newest first." }
        (parameters.form(&tasks))
        @if jobs.is_empty() {
            p.panel.empty { "No jobs match these filters." }
        } @else {
            div.scroll { table {
                thead { tr {
                    th { "State" } th { "Kind" } th { "Job" } th { "Task" } th { "Progress" } th { "Summary" }
                    th.number { "Attempt" } th.number { "Age" }
                } }
                tbody #jobs data-live[live] { @for job in &jobs { (row(job, (&names, &standings), now)) } }
            } }
            (sheet::links(&request.without("before")))
        }
        @if let Some(next) = &next {
            p.pages { a.button href=(request.with("before", Some(next.as_str()))) { "Older" } }
        }
    };
    let head = Head { title: "Jobs", tab: Tab::Jobs, task: None, script: Some("jobs.js") };
    Ok(shell::page(&request, &head, &body).into_response())
}

impl Parameters {
    async fn filter(&self, backend: &dyn Backend) -> Result<JobFilter> {
        let task_id = if self.task.is_empty() { None } else { Some(backend.task(&self.task).await?.id) };
        let state = word("state", &self.state, JobState::from_word, &JobState::ALL.map(JobState::as_str))?;
        let kind = word("kind", &self.kind, JobKind::from_word, &JobKind::ALL.map(JobKind::as_str))?;
        Ok(JobFilter { task_id, state, kind })
    }

    fn form(&self, tasks: &[(TaskId, String)]) -> Markup {
        let choice = |name: &str, label: &str, chosen: &str, words: Vec<&str>| {
            html! { label { (label)
                select name=(name) {
                    option value="" { "all" }
                    @for word in words { option value=(word) selected[word == chosen] { (word) } }
                }
            } }
        };
        html! {
            form.filters method="get" action="/jobs" {
                // A text field with suggestions: a drop-down list is unusable with a thousand tasks.
                label { "Task" input type="search" name="task" value=(self.task) list="tasks" placeholder="all" maxlength="128"; }
                datalist id="tasks" { @for (_, name) in tasks { option value=(name) {} } }
                (choice("state", "State", &self.state, JobState::ALL.map(JobState::as_str).to_vec()))
                (choice("kind", "Kind", &self.kind, JobKind::ALL.map(JobKind::as_str).to_vec()))
                button type="submit" { "Show" }
            }
        }
    }
}

/// One of a few words; empty for no filter.
fn word<T>(field: &str, text: &str, read: fn(&str) -> Option<T>, words: &[&str]) -> Result<Option<T>> {
    if text.is_empty() {
        return Ok(None);
    }
    read(text).map(Some).ok_or_else(|| Error::invalid(field, format!("must be one of {}", words.join(", "))))
}

/// What the list has of the message of a job, or of its error.
fn summary(job: &Job) -> &str {
    if job.error.is_empty() { &job.message } else { &job.error }
}

fn row(job: &Job, (names, standings): (&HashMap<&TaskId, &str>, &Standings), now: Millis) -> Markup {
    html! { tr id=(job.id) {
        td { (state(job)) }
        td { (job.spec.kind().as_str()) }
        td { (link::brief(job.id.as_str(), Some(&format!("/jobs/{}", job.id)))) }
        td { @if let Some(name) = names.get(&job.task_id) { a href=(format!("/tasks/{name}/episodes")) { (name) } } }
        td.progress {
            @if job.total > 0 {
                progress value=(job.done.min(job.total)) max=(job.total) aria-label="Progress" {}
                small.soft { " " (text::count(job.done)) " of " (text::count(job.total)) }
            }
        }
        td.message { (link::text_where(summary(job), |id| standings.has_page(id))) }
        td.number { (job.attempt) span.soft { " of " (job.max_attempts) } }
        td.number title=(text::stamp(job.created_at)) { (age(job.created_at, now)) }
    } }
}

/// How long ago, in the unit that fits.
fn age(then: Millis, now: Millis) -> String {
    let seconds = now.0.saturating_sub(then.0).max(0) / 1000;
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3600 => format!("{} min", seconds / 60),
        3600..172_800 => format!("{} h", seconds / 3600),
        172_800.. => format!("{} days", seconds / 86_400),
        i64::MIN..0 => String::new(),
    }
}

/// Every matching job older than `before`, or every one, for programs. The rows are read a page at a time.
async fn sheet_of(
    backend: &dyn Backend,
    filter: &JobFilter,
    before: Option<JobId>,
    names: &HashMap<&TaskId, &str>,
) -> Result<Sheet> {
    let row = |job: &Job| {
        vec![
            json!(job.id),
            json!(names.get(&job.task_id)),
            json!(job.spec.kind().as_str()),
            json!(job.state.as_str()),
            json!(job.done),
            json!(job.total),
            json!(job.message),
            json!(job.error),
            json!(job.attempt),
            json!(job.max_attempts),
            json!(job.priority),
            json!(job.key),
            json!(job.result_id),
            json!(job.peak_memory_bytes),
            json!(text::stamp(job.created_at)),
            json!(job.started_at.map(text::stamp)),
            json!(job.ended_at.map(text::stamp)),
        ]
    };
    let columns = &[
        "job_id",
        "task",
        "kind",
        "state",
        "done",
        "total",
        "message",
        "error",
        "attempt",
        "max_attempts",
        "priority",
        "key",
        "result_id",
        "peak_memory_bytes",
        "created_at",
        "started_at",
        "ended_at",
    ];
    let (mut rows, mut next) = (Vec::new(), before);
    loop {
        let (jobs, older) = backend.jobs(filter, next.as_ref(), SIZE).await?;
        rows.extend(jobs.iter().map(row));
        next = older;
        if next.is_none() {
            return Ok(Sheet { name: "jobs".to_owned(), columns, rows });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_words_are_rejected_with_the_known_ones() {
        let read = |text| word("state", text, JobState::from_word, &JobState::ALL.map(JobState::as_str));
        assert_eq!((read("").unwrap(), read("failed").unwrap()), (None, Some(JobState::Failed)));
        let answer = read("done").unwrap_err();
        assert_eq!(answer.message(), "state: must be one of queued, running, succeeded, failed, cancelled");
    }

    #[test]
    fn ages_are_short() {
        let ages = [0, 59_999, 60_000, 7_200_000, 200_000_000].map(|ago| age(Millis(0), Millis(ago)));
        assert_eq!(ages, ["0 s", "59 s", "1 min", "2 h", "2 days"]);
        assert_eq!(age(Millis(5), Millis(0)), "0 s", "a clock that was set back");
    }
}
