//! A task's episodes: a table that filters, sorts and labels.

mod filters;
mod label;
mod query;
mod table;

use std::sync::Arc;

use axum::{extract::Path, response::IntoResponse as _};
use gleaner_core::{
    Error, Result,
    curation::{SortKey, TableRow, sort, sort_ids},
    id::{EpisodeId, ScoreRunId},
    score::ScoreRun,
    task::Task,
};
use maud::{Markup, html};
use serde_json::json;

use self::query::{EpisodeParameters, EpisodeQuery, Order};
pub(crate) use self::{
    filters::describe,
    label::{buttons, label, live},
};
use super::{
    page_request::PageRequest,
    paging,
    refusal::Answer,
    sheet::{self, Format, Sheet},
    shell::{self, Head, Tab},
    text,
};
use crate::{
    backend::{Backend, RunSummary},
    page::Page,
};

/// Episodes on one page.
const PER_PAGE: usize = 100;

/// The data of the table.
struct View<'a> {
    request: &'a PageRequest,
    task: &'a Task,
    parameters: &'a EpisodeParameters,
    query: &'a EpisodeQuery,
    /// The run of the shown q, if the task has any.
    scores: Option<Arc<dyn RunSummary>>,
    /// The number of matching episodes.
    count: usize,
    /// Those of the shown page, or all of a sheet, sorted.
    rows: Vec<TableRow>,
}

impl View<'_> {
    fn mean_q(&self, row: &TableRow) -> Option<f64> {
        self.scores.as_ref().and_then(|scores| scores.mean_q(&row.episode.id))
    }

    /// Whether the caller may label.
    fn labels(&self) -> bool {
        self.request.may(Page::LabelEpisodes)
    }

    /// The shown page, from 1, and the number of pages. A page beyond the end is the last.
    fn page(&self) -> (usize, usize) {
        paging::within(self.query.page, self.count, PER_PAGE)
    }
}

pub(super) async fn show(request: PageRequest, Path(task): Path<String>) -> Answer {
    let parameters: EpisodeParameters = request.parameters()?;
    let query = parameters.read()?;
    let backend = request.backend();
    let task = backend.task(&task).await?;
    let runs = backend.score_runs(&task.id).await?;
    let scores = match chosen(&runs, query.run.as_ref(), &task)? {
        Some(run) => Some(backend.summary(run).await?),
        None => None,
    };
    let (count, rows) = rows(backend, &task, &query, parameters.format, scores.clone()).await?;
    let view = View { request: &request, task: &task, parameters: &parameters, query: &query, scores, count, rows };
    if parameters.format != Format::Html {
        return Ok(sheet_of(&view).answer(parameters.format)?);
    }
    let cohorts = backend.cohorts(&task.id).await?;
    let name = task.spec.name.as_str();
    let head = Head {
        title: &format!("Episodes of {name}"),
        tab: Tab::Episodes,
        task: Some(name),
        script: Some("episodes.js"),
    };
    Ok(shell::page(&request, &head, &body(&view, &runs, &cohorts)).into_response())
}

/// The number of matching episodes, and those of the shown page, or all for a sheet. The database sorts and cuts, unless
/// the order or the filter is by mean q, which it does not have: then the ids are sorted and cut here, and only the rows
/// of the page are read.
async fn rows(
    backend: &dyn Backend,
    task: &Task,
    query: &EpisodeQuery,
    format: Format,
    scores: Option<Arc<dyn RunSummary>>,
) -> Result<(usize, Vec<TableRow>)> {
    let first = |count: usize| (paging::within(query.page, count, PER_PAGE).0 - 1) * PER_PAGE;
    let Order { key, descending } = query.order;
    if format == Format::Html && key != SortKey::MeanQ && query.mean_q.is_none() {
        let count = backend.count_episodes(&task.id, &query.filter).await?;
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        let part = (first(count), PER_PAGE);
        return Ok((count, backend.episode_page(&task.id, &query.filter, (key, descending), part).await?));
    }
    if format == Format::Html && matches!(key, SortKey::MeanQ | SortKey::Date) {
        let ids = backend.matching_episodes(&task.id, &query.filter).await?;
        let ids = ordered_ids(ids, scores, query.mean_q, query.order).await?;
        let from = first(ids.len());
        let shown = ids.get(from..ids.len().min(from + PER_PAGE)).unwrap_or_default();
        return Ok((ids.len(), backend.episode_rows(shown).await?));
    }
    let rows = backend.episode_table(&task.id, &query.filter).await?;
    let mut rows = ordered(rows, scores, query.mean_q, query.order).await?;
    let count = rows.len();
    if format == Format::Html {
        rows = rows.into_iter().skip(first(count)).take(PER_PAGE).collect();
    }
    Ok((count, rows))
}

/// The ids of episodes with matching mean q, by mean q or by date, in the order that [`sort`] gives their rows: ids are in
/// the order of time.
async fn ordered_ids(
    ids: Vec<EpisodeId>,
    scores: Option<Arc<dyn RunSummary>>,
    fits: Option<(f64, f64)>,
    order: Order,
) -> Result<Vec<EpisodeId>> {
    let ordering = move || {
        let mean_q = |id: &EpisodeId| scores.as_ref().and_then(|scores| scores.mean_q(id));
        let mut keyed: Vec<(Option<f64>, EpisodeId)> = ids.into_iter().map(|id| (mean_q(&id), id)).collect();
        if let Some((from, to)) = fits {
            keyed.retain(|(q, _)| q.is_some_and(|q| (from..=to).contains(&q)));
        }
        sort_ids(&mut keyed, order.key == SortKey::MeanQ, order.descending);
        keyed.into_iter().map(|(_, id)| id).collect()
    };
    tokio::task::spawn_blocking(ordering).await.map_err(|error| Error::internal("sorting episodes", error))
}

/// The rows with matching mean q, in order. Ten thousand rows take long, so this runs off the runtime.
async fn ordered(
    mut rows: Vec<TableRow>,
    scores: Option<Arc<dyn RunSummary>>,
    fits: Option<(f64, f64)>,
    order: Order,
) -> Result<Vec<TableRow>> {
    let ordering = move || {
        let mean_q = |id: &_| scores.as_ref().and_then(|scores| scores.mean_q(id));
        if let Some((from, to)) = fits {
            rows.retain(|row| mean_q(&row.episode.id).is_some_and(|q| (from..=to).contains(&q)));
        }
        sort(&mut rows, order.key, order.descending, mean_q);
        rows
    };
    tokio::task::spawn_blocking(ordering).await.map_err(|error| Error::internal("sorting episodes", error))
}

/// The run in the query, or the newest.
fn chosen<'a>(runs: &'a [ScoreRun], named: Option<&ScoreRunId>, task: &Task) -> Result<Option<&'a ScoreRunId>> {
    let Some(named) = named else { return Ok(runs.first().map(|run| &run.id)) };
    let found = runs.iter().find(|run| run.id == *named).map(|run| &run.id);
    let missing = || Error::not_found("finished score run", format!("{named} of task {}", task.spec.name));
    found.map(Some).ok_or_else(missing)
}

fn body(view: &View, runs: &[ScoreRun], cohorts: &[String]) -> Markup {
    let (page, pages) = view.page();
    let count = u64::try_from(view.count).unwrap_or(u64::MAX);
    html! {
        h1 { "Episodes" }
        p.lead { (text::counted(count, "episode")) @if count != 0 { ", page " (page) " of " (pages) } }
        (filters::form(view, runs, cohorts))
        @if view.rows.is_empty() {
            p.panel.empty {
                "No episodes match these filters. " a href=(view.request.uri.path()) { "Show all" } ", or add some with "
                code { "gleaner push" } "."
            }
        } @else {
            @if view.labels() { (label::bar(cohorts)) }
            (table::table(view))
            (sheet::links(view.request))
            (paging::links(view.request, "Pages of the table", (page, pages)))
        }
    }
}

fn sheet_of(view: &View) -> Sheet {
    let row = |row: &TableRow| {
        let TableRow { episode, label_version, labelled_by, labelled_at } = row;
        vec![
            json!(episode.id),
            json!(episode.file_name),
            json!(episode.outcome.as_str()),
            json!(episode.cohort),
            json!(episode.steps),
            json!(episode.duration_s),
            json!(episode.warnings),
            json!(view.mean_q(row)),
            json!(labelled_by),
            json!(text::stamp(*labelled_at)),
            json!(label_version),
            json!(text::stamp(episode.created_at)),
            json!(episode.size_bytes),
        ]
    };
    Sheet {
        name: format!("episodes-{}", view.task.spec.name),
        columns: &[
            "id",
            "file_name",
            "outcome",
            "cohort",
            "steps",
            "duration_s",
            "warnings",
            "mean_q",
            "labelled_by",
            "labelled_at",
            "label_version",
            "created_at",
            "size_bytes",
        ],
        rows: view.rows.iter().map(row).collect(),
    }
}
