//! Deployments with their history, and their running sessions.

mod live;
mod one;

use axum::response::IntoResponse as _;
use gleaner_core::policy::Deployment;
use maud::{Markup, html};
use serde_json::json;

pub(super) use self::{
    live::{fragment, frame},
    one::{roll_back, show},
};
use super::{
    page_request::PageRequest,
    refusal::Answer,
    sheet::{self, Format, Sheet},
    shell::{self, Head, Tab},
    text,
};

/// A deployment with its task's name and its number of sessions.
struct Row {
    deployment: Deployment,
    task: String,
    sessions: usize,
}

pub(super) async fn list(request: PageRequest) -> Answer {
    let format = sheet::format(&request)?;
    let backend = request.backend();
    let live = backend.live();
    let mut rows = Vec::new();
    for deployment in backend.deployments(None).await? {
        let task = backend.task_by_id(&deployment.task_id).await?.spec.name;
        let sessions = live.iter().filter(|(session, _)| session.deployment == deployment.name).count();
        rows.push(Row { deployment, task, sessions });
    }
    if format != Format::Html {
        return Ok(sheet(&rows).answer(format)?);
    }
    let body = html! {
        h1 { "Deployments" }
        p.lead { "The policies served to robots and simulators, by name." }
        @if rows.is_empty() {
            (empty())
        } @else {
            div.scroll { table {
                thead { tr { th { "Name" } th { "Task" } th { "Policy" } th { "Live score" } th.number { "Sessions" }
                    th.number { "Since (UTC)" } } }
                tbody { @for row in &rows { (line(row)) } }
            } }
            (sheet::links(&request))
        }
    };
    let head = Head { title: "Deployments", tab: Tab::Deployments, task: None, script: None };
    Ok(shell::page(&request, &head, &body).into_response())
}

fn empty() -> Markup {
    html! {
        p.panel.empty { "No deployments yet. Create one with " code { "gleaner deploy NAME --policy POLICY" } "." }
    }
}

fn line(row: &Row) -> Markup {
    let Row { deployment, task, sessions } = row;
    let now = deployment.history.last();
    html! {
        tr {
            td { a href=(format!("/deployments/{}", super::page_request::escaped(&deployment.name))) { (deployment.name) } }
            td { a href=(format!("/tasks/{task}/episodes")) { (task) } }
            @if let Some(now) = now {
                td { a.id href=(format!("/policies/{}", now.assignment.policy_id)) { (now.assignment.policy_id) } }
                td { @match &now.assignment.score_run_id {
                    Some(run) => a.id href=(format!("/runs/{run}")) { (run) },
                    None => span.soft { "none" },
                } }
                td.number { (sessions) }
                td.number { (text::time(now.since)) }
            }
        }
    }
}

fn sheet(rows: &[Row]) -> Sheet {
    let columns = &["name", "task", "policy_id", "score_run_id", "sessions", "since", "changes"];
    let row = |Row { deployment, task, sessions }: &Row| {
        let now = deployment.history.last();
        vec![
            json!(deployment.name),
            json!(task),
            json!(deployment.policy_id().map(|id| id.as_str())),
            json!(deployment.score_run_id().map(|id| id.as_str())),
            json!(sessions),
            json!(now.map(|change| text::stamp(change.since))),
            json!(deployment.history.len()),
        ]
    };
    Sheet { name: "deployments".to_owned(), columns, rows: rows.iter().map(row).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_without_deployments_shows_the_command_that_creates_one() {
        let shown = empty().into_string();
        assert!(shown.contains("<code>gleaner deploy NAME --policy POLICY</code>"), "{shown}");
    }
}
