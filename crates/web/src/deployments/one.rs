//! One deployment: its policy, its history, rolling back, and its sessions.

use axum::{
    Form,
    extract::{FromRequest as _, Path, Request},
    http::{StatusCode, header::LOCATION},
    response::{IntoResponse as _, Response},
};
use gleaner_core::{
    Error, Result,
    policy::{Assignment, Deployment, DeploymentChange},
};
use maud::{Markup, html};
use serde::Deserialize;
use serde_json::json;

use super::live;
use crate::{
    change::{change, is_form},
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
                input type="hidden" name="changes" value=(deployment.history.len());
                button.danger type="submit" { "Roll back" }
                span.soft { "to " span.id { (policy) } ". Running sessions keep the policy they have." }
            }
        }
    };
    let head = Head { title: &deployment.name, tab: Tab::Deployments, task: Some(&task), script: Some("live.js") };
    Ok(shell::page(&request, &head, &body).into_response())
}

pub(crate) async fn roll_back(page_request: PageRequest, Path(name): Path<String>, request: Request) -> Response {
    let rolled = async {
        let (backend, shown) = (page_request.backend(), shown(request).await?);
        let _alone = page_request.state.rolling_back.lock().await;
        // A second click would restore the policy before the one that the page named.
        if let Some(changes) = shown.changes
            && backend.deployment(&name).await?.history.len() != changes
        {
            return Err(Error::precondition(format!(
                "deployment {name} has changed since its page was shown; reload the page to see what it serves now"
            ))
            .into());
        }
        let deployment = backend.roll_back(&name).await?;
        if let Some(policy) = deployment.policy_id() {
            page_request.audit.about("policy_id", policy.as_str());
        }
        let to = format!("/deployments/{}", escaped(&name));
        Ok((StatusCode::SEE_OTHER, [(LOCATION, to)]).into_response())
    };
    change(&page_request, [("name", name.as_str())], rolled).await
}

/// What the form's page showed; programs need not send it.
#[derive(Default, Deserialize)]
struct Shown {
    /// The length of the deployment's history.
    changes: Option<usize>,
}

async fn shown(request: Request) -> Result<Shown> {
    if !is_form(request.headers()) {
        return Ok(Shown::default());
    }
    let read = Form::<Shown>::from_request(request, &()).await;
    read.map(|Form(shown)| shown).map_err(|rejection| Error::invalid("body", rejection.body_text()))
}

fn facts(deployment: &Deployment) -> Markup {
    html! {
        @if let Some(now) = deployment.history.last() {
            dl.facts.panel {
                dt { "Policy" } dd { a.id href=(format!("/policies/{}", now.assignment.policy_id)) { (now.assignment.policy_id) } (hidden(&now.assignment)) }
                dt { "Live score" } dd { (scorer(now)) }
                dt { "Since" } dd { (text::time(now.since)) " UTC" }
            }
        }
    }
}

/// Whether the policy acts without its history.
fn hidden(assignment: &Assignment) -> Markup {
    html! { @if assignment.hide_history { " " span.soft { "history hidden" } } }
}

fn scorer(change: &DeploymentChange) -> Markup {
    html! {
        @match &change.assignment.score_run_id {
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
                        td { a.id href=(format!("/policies/{}", change.assignment.policy_id)) { (change.assignment.policy_id) } (hidden(&change.assignment)) }
                        td { @match &change.assignment.score_run_id {
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
        let Assignment { policy_id, score_run_id, hide_history } = &change.assignment;
        let run = score_run_id.as_ref().map(|run| run.as_str());
        vec![json!(text::stamp(change.since)), json!(policy_id.as_str()), json!(run), json!(hide_history)]
    };
    Sheet {
        name: format!("{}-history", deployment.name),
        columns: &["since", "policy_id", "score_run_id", "hide_history"],
        rows: deployment.history.iter().rev().map(row).collect(),
    }
}
