//! One deployment: its policy, its history, rolling back, and its sessions.

use axum::{
    extract::Path,
    http::{StatusCode, header::LOCATION},
    response::{IntoResponse as _, Response},
};
use gleaner_core::policy::{Deployment, DeploymentChange};
use maud::{Markup, html};
use serde_json::json;

use super::live;
use crate::{
    change::about,
    page::Page,
    page_request::{PageRequest, escaped},
    refusal::Answer,
    sheet::{self, Format, Sheet},
    shell::{self, Head, Tab},
    text,
};

pub(crate) async fn show(request: PageRequest, Path(name): Path<String>) -> Answer {
    let backend = request.backend();
    let deployment = backend.deployment(&name).await?;
    let format = sheet::format(&request)?;
    if format != Format::Html {
        return Ok(history_sheet(&deployment).answer(format)?);
    }
    let task = backend.task_by_id(&deployment.task_id).await?.spec.name;
    let back = backend.previous_policy(&name).await.ok();
    let body = html! {
        h1 { (deployment.name) }
        p.lead { "Serves " a href=(format!("/tasks/{task}/episodes")) { (task) } "." }
        (facts(&deployment))
        h2 { "Live sessions" }
        div #live data-from=(format!("/deployments/{}/live", escaped(&name))) aria-live="off" {
            (live::sessions(&request, &name))
        }
        h2 { "History" }
        (history(&deployment))
        (sheet::links(&request))
        @if let (Some(policy), true) = (back, request.may(Page::RollBack)) {
            form.row method="post" action=(format!("/deployments/{}/roll-back", escaped(&name))) {
                input type="hidden" name="proof" value=(request.proof);
                button.danger type="submit" { "Roll back" }
                span.soft { "to " span.id { (policy) } ". Running sessions keep the policy they have." }
            }
        }
    };
    let head = Head { title: &deployment.name, tab: Tab::Deployments, task: Some(&task), script: Some("live.js") };
    Ok(shell::page(&request, &head, &body).into_response())
}

pub(crate) async fn roll_back(request: PageRequest, Path(name): Path<String>) -> Response {
    let rolled = request.backend().roll_back(&name).await;
    let policy = rolled.as_ref().ok().and_then(Deployment::policy_id).cloned();
    let to = format!("/deployments/{}", escaped(&name));
    let answer = rolled.map(|_| (StatusCode::SEE_OTHER, [(LOCATION, to)]).into_response()).map_err(Into::into);
    let subjects = [Some(("name", name.as_str())), policy.as_ref().map(|policy| ("policy_id", policy.as_str()))];
    about(subjects.into_iter().flatten(), answer)
}

fn facts(deployment: &Deployment) -> Markup {
    html! {
        @if let Some(now) = deployment.history.last() {
            dl.facts.panel {
                dt { "Policy" } dd { a.id href=(format!("/policies/{}", now.policy_id)) { (now.policy_id) } }
                dt { "Live score" } dd { (scorer(now)) }
                dt { "Since" } dd { (text::time(now.since)) " UTC" }
            }
        }
    }
}

fn scorer(change: &DeploymentChange) -> Markup {
    html! {
        @match &change.score_run_id {
            Some(run) => a.id href=(format!("/runs/{run}")) { (run) },
            None => span.soft { "none; deploy with a score run to score sessions while they run" },
        }
    }
}

fn history(deployment: &Deployment) -> Markup {
    html! {
        div.scroll { table {
            thead { tr { th { "Since (UTC)" } th { "Policy" } th { "Live score" } } }
            tbody {
                @for change in deployment.history.iter().rev() {
                    tr {
                        td { (text::time(change.since)) }
                        td { a.id href=(format!("/policies/{}", change.policy_id)) { (change.policy_id) } }
                        td { @match &change.score_run_id {
                            Some(run) => a.id href=(format!("/runs/{run}")) { (run) },
                            None => span.soft { "none" },
                        } }
                    }
                }
            }
        } }
    }
}

/// The history as a table for programs, the newest first.
fn history_sheet(deployment: &Deployment) -> Sheet {
    let row = |change: &DeploymentChange| {
        let run = change.score_run_id.as_ref().map(|run| run.as_str());
        vec![json!(text::stamp(change.since)), json!(change.policy_id.as_str()), json!(run)]
    };
    Sheet {
        name: format!("{}-history", deployment.name),
        columns: &["since", "policy_id", "score_run_id"],
        rows: deployment.history.iter().rev().map(row).collect(),
    }
}
