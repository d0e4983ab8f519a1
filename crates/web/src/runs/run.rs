//! One score run: its histogram with a threshold, and all counts of the threshold.

use axum::{extract::Path, response::IntoResponse as _};
use gleaner_core::{
    Group as _, Result, Values, Words as _,
    curation::SegmentRef,
    id::{EpisodeId, ScoreRunId},
    score::{Origin, ScoreRun},
    selection::{Rule, SelectionShape, WhatIf},
    snapshot::Snapshot,
    task::Task,
};
use maud::{Markup, html};

use super::{
    contact, kept, picture,
    query::{Order, RunParameters, fields, parameters},
};
use crate::{
    Backend, artifacts,
    backend::RunSummary,
    link,
    page::Page,
    page_request::PageRequest,
    refusal::Answer,
    settings,
    sheet::Format,
    shell::{self, Head, Tab},
    standing::Standings,
    text,
};

pub(crate) async fn show(request: PageRequest, Path(id): Path<String>) -> Answer {
    let parameters: RunParameters = request.parameters()?;
    let order = parameters.order()?;
    let summary = request.backend().summary(&ScoreRunId::parse("id", &id)?).await?;
    let selection = parameters.selection(summary.run())?;
    let what = summary.what_if(selection).await?;
    let (run, format) = (summary.run(), parameters.format(Format::Html));
    if format != Format::Html {
        return Ok(kept::episode_sheet(&run.id, kept::rows(&what, &*summary, order)).answer(format)?);
    }
    let backend = request.backend();
    let task = backend.task_by_id(&run.task_id).await?;
    let body = html! {
        h1 { "Score run " (link::tail(run.id.as_str())) }
        p.lead { (run.origin.scorer()) " over " (text::counted(what.total.of_episodes, "imperfect episode")) ", against "
            (text::counted(run.expert_ids.len() as u64, "expert")) ", " (text::time(run.created_at)) " UTC" }
        (threshold(&request, &*summary, &what).await?)
        (following(backend, &*summary, &what, order).await?)
        (sheets(backend, &*summary, &task).await?)
        h2 { "Lineage" }
        (artifacts::of_run(backend, run).await?)
        h2 { "Facts" }
        (facts(run, &backend.snapshot(&run.snapshot_id).await?))
    };
    let head = Head { title: "Score run", tab: Tab::Runs, task: Some(&task.spec.name), script: Some("run.js") };
    Ok(shell::page(&request, &head, &body).into_response())
}

/// The counts of a selection: as JSON, or as the parts of the page that follow the slider.
pub(crate) async fn what_if(request: PageRequest, Path(id): Path<String>) -> Answer {
    let parameters: RunParameters = request.parameters()?;
    let order = parameters.order()?;
    let summary = request.backend().summary(&ScoreRunId::parse("id", &id)?).await?;
    let selection = parameters.selection(summary.run())?;
    let what = summary.what_if(selection).await?;
    match parameters.format(Format::Json) {
        Format::Html => Ok(following(request.backend(), &*summary, &what, order).await?.into_response()),
        Format::Json => Ok(axum::Json(kept::counts(&summary.run().id, &what)).into_response()),
        Format::Csv => Ok(kept::cohort_sheet(format!("{id}-cohorts"), &what).answer(Format::Csv)?),
    }
}

/// The histogram with its slider, and the button to make a dataset.
async fn threshold(request: &PageRequest, summary: &dyn RunSummary, what: &WhatIf) -> Result<Markup> {
    let histogram = summary.histogram(picture::BINS).await?;
    let run = &summary.run().id;
    let beta = match what.selection.rule {
        Rule::Beta(beta) => Some(beta),
        Rule::TopFraction(_) => None,
    };
    Ok(html! {
        section.panel.threshold aria-label="Threshold" {
            (picture::histogram(&histogram, what.selection.rule))
            (picture::separation(&summary.expert_ranking().await?))
            div.row {
                form #threshold.row method="get" action=(format!("/runs/{run}")) data-run=(run.as_str()) {
                    label for="slider" { "Keep segments with q above β" }
                    input #slider type="range" min="0" max="1" step="0.01" value=[beta] aria-label="β, as a slider";
                    input #beta name="beta" type="number" min="0" max="1" step="any" value=[beta] required
                        aria-label="β, as a number";
                    button type="submit" { "Show" }
                }
                @if request.may(Page::MakeDataset) {
                    form #make method="post" action=(format!("/runs/{run}/datasets")) {
                        input type="hidden" name="proof" value=(request.proof);
                        @for (name, value) in fields(what.selection) {
                            input type="hidden" name=(name) value=(value);
                        }
                        button.primary type="submit" { "Create dataset" }
                    }
                }
            }
            (shape(what.selection.shape))
            @if beta.is_none() {
                p.note { "Showing a top fraction: " (link::selection(what.selection)) ". Move the slider to select by β." }
            }
            p #trouble.note.bad role="alert" hidden {}
        }
    })
}

/// The shape of the selection, as fields of the form with the threshold.
fn shape(shape: SelectionShape) -> Markup {
    let mut values = Values::new();
    shape.write(&mut values);
    html! {
        details #shape open[!shape.is_off()] {
            summary { "Shape: runs, context and limits" }
            div.row {
                @for setting in SelectionShape::schema() {
                    @let range = setting.shape.range();
                    label title=(setting.about) {
                        (setting.name.replace('_', " ")) " "
                        input form="threshold" type="number" name=(setting.name) data-default=(setting.default)
                            min=[range.map(|(least, ..)| least)] max=[range.map(|(_, most, _)| most)]
                            step=(if range.is_some_and(|(.., whole)| whole) { "1" } else { "any" })
                            value=[values.get(&setting.name)];
                    }
                }
            }
        }
    }
}

/// The parts that follow the threshold.
async fn following(backend: &dyn Backend, summary: &dyn RunSummary, what: &WhatIf, order: Order) -> Result<Markup> {
    let run = &summary.run().id;
    let rows = kept::first_rows(what, summary, order, kept::SHOWN);
    let ids: Vec<EpisodeId> = rows.iter().map(|row| row.episode.clone()).collect();
    let standings = Standings::of(backend, &ids).await?;
    let counts = format!("/runs/{run}/what-if?{}", parameters(what.selection));
    Ok(html! {
        section #counts aria-live="polite" aria-label="Kept segments" { (kept::figures(what)) }
        h2 { "By cohort" }
        div #by-cohort {
            (kept::cohorts(what))
            p.formats { "All counts as " a href=(format!("{counts}&format=json")) { "JSON" } ", this table as "
                a href=(format!("{counts}&format=csv")) { "CSV" } }
        }
        h2 { "By episode" }
        div #by-episode {
            (kept::episodes(run, what.selection, order, (&rows, what.episodes.len()), &standings))
        }
    })
}

async fn sheets(backend: &dyn Backend, summary: &dyn RunSummary, task: &Task) -> Result<Markup> {
    let (best, worst) = (summary.best(contact::SEGMENTS).await?, summary.worst(contact::SEGMENTS).await?);
    let ids: Vec<EpisodeId> =
        best.iter().chain(&worst).map(|SegmentRef { episode_id, .. }| episode_id.clone()).collect();
    let standings = Standings::of(backend, &ids).await?;
    let (run, camera) = (&summary.run().id, task.spec.cameras.first());
    Ok(html! {
        h2 { "Best segments" }
        (contact::sheet(run, camera, &best, &standings))
        h2 { "Worst segments" }
        (contact::sheet(run, camera, &worst, &standings))
    })
}

fn facts(run: &ScoreRun, snapshot: &Snapshot) -> Markup {
    html! {
        dl.facts.panel {
            dt { "Score run" } dd.id { (run.id) }
            dt { "Scorer" } dd { (run.origin.scorer()) }
            @match &run.origin {
                Origin::Job { spec, .. } => {
                    @for (name, value) in settings::rows(&spec.scorer.settings) { dt { (name) } dd { (value) } }
                    dt { "Normaliser" }
                    dd { (spec.normaliser.as_str()) "; of what it is applied to, " (format!("{:.3}", run.lo))
                        " is q = 0 and " (format!("{:.3}", run.hi)) " is q = 1" }
                }
                Origin::Import { source, .. } => { dt { "Source" } dd { (source) } }
            }
            dt { "Episodes" } dd { (artifacts::episodes(snapshot)) " (" (link::whole(run.snapshot_id.as_str())) ")" }
            @if let Some(encoder) = run.origin.encoder_id() { dt { "Encoder" } dd { (link::whole(encoder.as_str())) } }
            @if let Some(base) = &run.extends { dt { "Extends" } dd { (link::whole(base.as_str())) } }
            @if let Some(job) = run.origin.job_id() { dt { "Created by" } dd { (link::whole(job.as_str())) } }
        }
    }
}
