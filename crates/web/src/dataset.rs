//! One dataset: its selection, its counts and the results made from it.

use axum::{extract::Path, response::IntoResponse as _};
use gleaner_core::{Error, Result, dataset::Dataset, error::Kind, id::DatasetId, selection::WhatIf};
use maud::{Markup, html};

use crate::{
    Backend,
    artifacts::of_dataset,
    link,
    page_request::PageRequest,
    refusal::Answer,
    runs,
    sheet::{self, Format},
    shell::{self, Head, Tab},
    text,
};

pub(super) async fn show(request: PageRequest, Path(id): Path<String>) -> Answer {
    let format = sheet::format(&request)?;
    let backend = request.backend();
    let dataset = backend.dataset(&DatasetId::parse("id", &id)?).await?;
    let kept = kept(backend, &dataset).await?;
    if format != Format::Html {
        let (what, _) = kept.map_err(Error::precondition)?;
        return Ok(runs::cohort_sheet(format!("{}-cohorts", dataset.id), &what).answer(format)?);
    }
    let task = backend.task_by_id(&dataset.task_id).await?;
    let body = html! {
        h1 { "Dataset " (link::tail(dataset.id.as_str())) }
        p.lead { "The imperfect segments with " (link::selection(dataset.selection)) ", each weighted by its q, and all experts. A dataset is a view, not a copy." }
        @match &kept {
            Ok((what, _)) => {
                (runs::figures(what))
                h2 { "By cohort" }
                (runs::cohorts(what))
                (sheet::links(&request))
            },
            Err(why) => p.note { (link::text(why)) " Counts appear once the run is finished." },
        }
        h2 { "Lineage" }
        (of_dataset(backend, &dataset).await?)
        h2 { "Facts" }
        (facts(&dataset, kept.as_ref().ok().map(|(_, experts)| *experts)))
    };
    let head = Head { title: "Dataset", tab: Tab::Runs, task: Some(&task.spec.name), script: None };
    Ok(shell::page(&request, &head, &body).into_response())
}

/// The kept segments and the experts' segments; or why they are unknown.
async fn kept(backend: &dyn Backend, dataset: &Dataset) -> Result<std::result::Result<(WhatIf, u64), String>> {
    match backend.summary(&dataset.score_run_id).await {
        Ok(summary) => {
            let what = summary.what_if(dataset.selection).await?;
            let experts = backend.expert_segments(summary.run()).await?;
            Ok(Ok((what, experts)))
        }
        Err(error) if error.kind() == Kind::Precondition => Ok(Err(error.message().to_owned())),
        Err(error) => Err(error),
    }
}

fn facts(dataset: &Dataset, expert_segments: Option<u64>) -> Markup {
    let run = &dataset.score_run_id;
    let at = format!("/runs/{run}?{}", runs::parameters(dataset.selection));
    html! {
        dl.facts.panel {
            dt { "Dataset" } dd.id { (dataset.id) }
            dt { "Keeps" } dd { (link::selection(dataset.selection)) }
            dt { "Score run" } dd { a.id href=(at) { (run) } }
            @if let Some(segments) = expert_segments { dt { "Experts' segments" } dd { (text::count(segments)) } }
            dt { "Created" } dd { (text::time(dataset.created_at)) " UTC" }
        }
    }
}
