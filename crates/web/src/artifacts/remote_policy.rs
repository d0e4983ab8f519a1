//! A policy that another server runs: where it comes from, its address, its success rates, deployments and rollouts.

use axum::response::IntoResponse as _;
use gleaner_core::{
    evaluation::Evaluation,
    policy::{Deployment, Policy},
    remote::{InputValue, RemoteInput, RemotePolicy},
    task::Task,
};
use maud::{Markup, html};

use super::{evaluations, lineage::of_remote_policy};
use crate::{
    link,
    page_request::PageRequest,
    refusal::Answer,
    shell::{self, Head, Tab},
    text,
};

/// The page; `deployments` are all of the task.
pub(super) async fn show(
    request: &PageRequest,
    (policy, remote): (&Policy, &RemotePolicy),
    task: &Task,
    (tried, deployments): (&[Evaluation], &[Deployment]),
) -> Answer {
    let of_it = |deployment: &&Deployment| deployment.policy_id() == Some(&policy.id);
    let acting: Vec<Deployment> = deployments.iter().filter(of_it).cloned().collect();
    let body = html! {
        h1 { "Policy " (link::tail(policy.id.as_str())) }
        p.lead { "made elsewhere for " (task.spec.name) ", runs on " (remote.address) ", registered "
            (text::time(policy.created_at)) " UTC" }
        h2 { "Evaluations" }
        (evaluations::section(request, tried, "gleaner drive DEPLOYMENT --report"))
        h2 { "Lineage" }
        (of_remote_policy(request.backend(), (policy, remote), &acting).await?)
        h2 { "Facts" }
        (facts(policy, remote, task, deployments))
    };
    let head = Head { title: "Policy", tab: Tab::Runs, task: Some(&task.spec.name), script: None };
    Ok(shell::page(request, &head, &body).into_response())
}

fn facts(policy: &Policy, remote: &RemotePolicy, task: &Task, deployments: &[Deployment]) -> Markup {
    let ever =
        |deployment: &&Deployment| deployment.history.iter().any(|change| change.assignment.policy_id == policy.id);
    let (now, before): (Vec<&Deployment>, Vec<&Deployment>) =
        deployments.iter().filter(ever).partition(|deployment| deployment.policy_id() == Some(&policy.id));
    html! {
        dl.facts.panel {
            dt { "Policy" } dd.id { (policy.id) }
            dt { "Source" } dd { @if remote.source.is_empty() { "not named" } @else { (remote.source) } }
            dt { "Address" } dd { (remote.address) " (" (remote.protocol.as_str()) ")" }
            @if !remote.model.is_empty() {
                dt { "Model" } dd { (remote.model) @if !remote.model_version.is_empty() { ", version " (remote.model_version) } }
            }
            dt { "Sent" } dd { @for (at, input) in remote.inputs.iter().enumerate() { @if at > 0 { ", " } (sent(input)) } }
            dt { "Actions" } dd { (remote.output) ", up to " (text::counted(remote.chunk_length.into(), "action")) ", "
                (execution(remote.execute_length)) @if remote.sequences { ", with the history of its sessions" } }
            dt { "Answers within" } dd { (remote.answer_within_ms) " ms" }
            dt { "Deployed as" } dd { (names(&now)) }
            @if !before.is_empty() { dt { "Deployed before" } dd { (names(&before)) } }
            dt { "Rollouts" }
            dd {
                @if now.is_empty() && before.is_empty() { "none" }
                @for deployment in now.iter().chain(&before) {
                    a href=(format!("/tasks/{}/episodes?cohort={}", task.spec.name, deployment.name)) { "cohort " (deployment.name) } " "
                }
            }
        }
    }
}

fn names(deployments: &[&Deployment]) -> Markup {
    html! {
        @if deployments.is_empty() { "not deployed" }
        @for deployment in deployments { a href=(format!("/deployments/{}", deployment.name)) { (deployment.name) } " " }
    }
}

fn execution(execute_length: u32) -> String {
    match execute_length {
        0 => "ensembled".to_owned(),
        actions => format!("{actions} executed before the next"),
    }
}

fn sent(input: &RemoteInput) -> String {
    let RemoteInput { name, value } = input;
    match value {
        InputValue::Camera(camera) => format!("{name}: camera {camera}"),
        InputValue::CameraPlanes(camera) => format!("{name}: camera {camera} by channel"),
        InputValue::Depth(camera) => format!("{name}: depth of {camera}"),
        InputValue::Proprioception => format!("{name}: proprioception"),
        InputValue::Field(field) => format!("{name}: field {field}"),
        InputValue::ExecutedAction => format!("{name}: executed action"),
        InputValue::Text(text) => format!("{name}: {text:?}"),
    }
}
