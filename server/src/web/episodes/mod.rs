//! A task's episodes: a table that filters, sorts and labels.

mod asked;
mod filters;
mod label;
mod table;

use std::sync::Arc;

use axum::{extract::Path, response::IntoResponse as _};
use maud::{Markup, html};
use serde_json::json;

use self::asked::{Asked, Order, Wanted};
pub(in crate::web) use self::{
    filters::said,
    label::{buttons, label, live},
};
use super::{
    paging,
    refusal::Answer,
    say,
    sheet::{self, Format, Sheet},
    shell::{self, Head, Tab},
    visit::Visit,
};
use crate::{
    access::Page,
    curation::Summary,
    domain::{
        curation::{TableRow, sort},
        id::ScoreRunId,
        score::ScoreRun,
        task::Task,
    },
    error::{Error, Result},
};

/// Episodes on one page.
const PER_PAGE: usize = 100;

/// Everything a table shows.
struct View<'a> {
    visit: &'a Visit,
    task: &'a Task,
    asked: &'a Asked,
    wanted: &'a Wanted,
    /// The run whose q is shown, if the task has any.
    scores: Option<Arc<Summary>>,
    /// Every episode that fits, sorted.
    rows: Vec<TableRow>,
}

impl View<'_> {
    fn mean_q(&self, row: &TableRow) -> Option<f64> {
        self.scores.as_ref().and_then(|scores| scores.mean_q(&row.episode.id))
    }

    /// Whether who looks may label.
    fn labels(&self) -> bool {
        self.visit.may(Page::LabelEpisodes)
    }

    /// The page that is shown, from 1, and how many there are. One beyond the end is the last.
    fn page(&self) -> (usize, usize) {
        paging::within(self.wanted.page, self.rows.len(), PER_PAGE)
    }

    /// The rows of that page.
    fn shown(&self) -> &[TableRow] {
        let first = (self.page().0 - 1) * PER_PAGE;
        &self.rows[first..(first + PER_PAGE).min(self.rows.len())]
    }
}

pub(super) async fn show(visit: Visit, Path(task): Path<String>) -> Answer {
    let asked: Asked = visit.asked()?;
    let wanted = asked.read()?;
    let rooms = visit.rooms();
    let task = rooms.store.task(&task).await?;
    let runs = rooms.store.score_runs(&task.id).await?;
    let scores = match chosen(&runs, wanted.run.as_ref(), &task)? {
        Some(run) => Some(rooms.curation.summary(run).await?),
        None => None,
    };
    let rows = rooms.store.episode_table(&task.id, &wanted.filter).await?;
    let rows = ordered(rows, scores.clone(), wanted.mean_q, wanted.order).await?;
    let view = View { visit: &visit, task: &task, asked: &asked, wanted: &wanted, scores, rows };
    if asked.format != Format::Html {
        return Ok(sheet_of(&view).answer(asked.format)?);
    }
    let cohorts = rooms.store.cohorts(&task.id).await?;
    let name = task.spec.name.as_str();
    let head = Head {
        title: &format!("Episodes of {name}"),
        tab: Tab::Episodes,
        task: Some(name),
        script: Some("episodes.js"),
    };
    Ok(shell::page(&visit, &head, &body(&view, &runs, &cohorts)).into_response())
}

/// Those rows whose mean q fits, in order. Ten thousand take their time, which is not the runtime's.
async fn ordered(
    mut rows: Vec<TableRow>,
    scores: Option<Arc<Summary>>,
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

/// The run that was asked for, or the newest.
fn chosen<'a>(runs: &'a [ScoreRun], asked: Option<&ScoreRunId>, task: &Task) -> Result<Option<&'a ScoreRunId>> {
    let Some(asked) = asked else { return Ok(runs.first().map(|run| &run.id)) };
    let found = runs.iter().find(|run| run.id == *asked).map(|run| &run.id);
    let missing = || Error::not_found("finished score run", format!("{asked} of task {}", task.spec.name));
    found.map(Some).ok_or_else(missing)
}

fn body(view: &View, runs: &[ScoreRun], cohorts: &[String]) -> Markup {
    let (page, pages) = view.page();
    let count = u64::try_from(view.rows.len()).unwrap_or(u64::MAX);
    html! {
        h1 { "Episodes" }
        p.lead { (say::counted(count, "episode")) @if count != 0 { ", page " (page) " of " (pages) } }
        (filters::form(view, runs, cohorts))
        @if view.rows.is_empty() {
            p.panel.empty {
                "No episode fits. " a href=(view.visit.uri.path()) { "Show all" } ", or bring some with "
                code { "gleaner push" } "."
            }
        } @else {
            @if view.labels() { (label::bar(cohorts)) }
            (table::table(view))
            (sheet::links(view.visit))
            (paging::links(view.visit, "Pages of the table", (page, pages)))
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
            json!(say::stamp(*labelled_at)),
            json!(label_version),
            json!(say::stamp(episode.created_at)),
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

#[cfg(test)]
mod tests;
