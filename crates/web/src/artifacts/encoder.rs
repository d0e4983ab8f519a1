//! One encoder: its pretraining, its data and the results made with it.

use axum::{extract::Path, response::IntoResponse as _};
use gleaner_core::{
    Error, PretrainSpec, Words as _, id::EncoderId, job::JobSpec, kinds::Family, score::Encoder, snapshot::Snapshot,
};
use maud::{Markup, html};

use super::{episodes, of_job};
use crate::{
    link,
    page_request::PageRequest,
    refusal::Answer,
    shell::{self, Head, Tab},
    text,
};

pub(crate) async fn show(request: PageRequest, Path(id): Path<String>) -> Answer {
    let backend = request.backend();
    let encoder = backend.encoder(&EncoderId::parse("id", &id)?).await?;
    let (task, job) = (backend.task_by_id(&encoder.task_id).await?, backend.job(&encoder.job_id).await?);
    let JobSpec::Pretrain { spec, .. } = &job.spec else {
        return Err(Error::internal("reading an encoder's spec", "its job is not a pretraining job").into());
    };
    let snapshot = backend.snapshot(&encoder.snapshot_id).await?;
    let body = html! {
        h1 { "Encoder " (link::tail(encoder.id.as_str())) }
        p.lead { (spec.model.preset.as_str()) ", pretrained for " (text::counted(spec.optim.steps, "step")) " on all episodes of a snapshot of "
            (task.spec.name) ", " (text::time(encoder.created_at)) " UTC" }
        h2 { "Lineage" }
        (of_job(backend, &job).await?)
        h2 { "Facts" }
        (facts(&encoder, spec, &snapshot))
    };
    let head = Head { title: "Encoder", tab: Tab::Runs, task: Some(&task.spec.name), script: None };
    Ok(shell::page(&request, &head, &body).into_response())
}

fn facts(encoder: &Encoder, spec: &PretrainSpec, snapshot: &Snapshot) -> Markup {
    let objectives: Vec<String> = spec.objectives.iter().map(|name| objective(name)).collect();
    html! {
        dl.facts.panel {
            dt { "Encoder" } dd.id { (encoder.id) }
            dt { "Objectives" } dd { (objectives.join(", ")) }
            dt { "Preset" } dd { (spec.model.preset.as_str()) }
            dt { "Segments" } dd { (text::counted(u64::from(spec.model.segment_length) + 1, "step")) }
            dt { "Steps" } dd { (text::count(spec.optim.steps)) }
            dt { "Episodes" } dd { (episodes(snapshot)) " (" (link::whole(snapshot.id.as_str())) ")" }
            dt { "Created by" } dd { (link::whole(encoder.job_id.as_str())) ", with its losses and every setting" }
            dt { "Checkpoint (BLAKE3)" } dd.id { (encoder.checkpoint) }
        }
    }
}

/// The objective's name in full, as its description begins.
fn objective(name: &str) -> String {
    let full = Family::Objective.find(name).and_then(|kind| kind.about.split_once(':'));
    full.map_or_else(|| name.to_owned(), |(full, _)| full.to_lowercase())
}
