//! The table: one row per episode, with the data that the labelling script needs.

use gleaner_core::curation::{SortKey, TableRow};
use maud::{Markup, html};

use super::{View, query::Order};
use crate::{frames, link, text};

/// The rows of the shown page.
pub(super) fn table(view: &View) -> Markup {
    let first = view.task.spec.cameras.first();
    let camera = first.map(|camera| camera.name.as_str());
    let labels = view.labels();
    html! {
        div.scroll {
            table #episodes data-task=(view.task.spec.name) data-labels=[labels.then_some("")] data-only=(view.parameters.outcome)
                data-width=[first.map(|camera| camera.width)] data-height=[first.map(|camera| camera.height)] {
                caption.unseen { "Episodes of " (view.task.spec.name) }
                (heads(view, camera.is_some()))
                tbody {
                    @for row in &view.rows { (row_of(view, row, camera)) }
                }
            }
        }
    }
}

fn heads(view: &View, pictures: bool) -> Markup {
    // Another order starts at its first page.
    let request = view.request.without("page");
    let head = |key: SortKey, title: &str, number: bool| {
        let order = view.query.order;
        let sorted = (order.key == key).then_some(if order.descending { "descending" } else { "ascending" });
        html! {
            th.number[number] scope="col" aria-sort=[sorted] {
                a href=(request.with("sort", Some(&order.by(key).word()))) { (title) (arrow(order, key)) }
            }
        }
    };
    html! {
        thead { tr {
            @if view.labels() {
                th scope="col" { input #all type="checkbox" aria-label="Select all on this page"; }
            }
            @if pictures { th scope="col" { span.unseen { "Picture" } } }
            th scope="col" { "Episode" }
            (head(SortKey::Outcome, "Outcome", false))
            (head(SortKey::Cohort, "Cohort", false))
            (head(SortKey::Steps, "Length", true))
            (head(SortKey::Findings, "Report", false))
            (head(SortKey::MeanQ, "Mean q", true))
            th scope="col" { "Last label (UTC)" }
            (head(SortKey::Date, "Added (UTC)", false))
        } }
    }
}

fn arrow(order: Order, key: SortKey) -> &'static str {
    match (order.key == key, order.descending) {
        (false, _) => "",
        (true, true) => " ▾",
        (true, false) => " ▴",
    }
}

fn row_of(view: &View, row: &TableRow, camera: Option<&str>) -> Markup {
    let TableRow { episode, label_version, labelled_by, labelled_at } = row;
    let (id, outcome) = (&episode.id, episode.outcome.as_str());
    let run = view.query.run.as_ref().map(|run| format!("?run={run}")).unwrap_or_default();
    html! {
        tr tabindex="-1" data-id=(id) data-version=(label_version) data-outcome=(outcome) data-cohort=(episode.cohort)
            data-steps=(episode.steps) data-frames=[camera.map(|camera| frames::before_step(id, camera))] {
            @if view.labels() {
                td { input type="checkbox" name="episode" value=(id) aria-label=(format!("Select {}", episode.file_name)); }
            }
            @if let Some(camera) = camera {
                td { img.thumb src=(frames::at(id, camera, episode.steps / 2, frames::THUMBNAIL)) alt="" loading="lazy"
                    width="72" height="54"; }
            }
            td.name { a href=(format!("/episodes/{id}{run}")) { (episode.file_name) } span.id.soft { (link::short(id.as_str())) } }
            td { span class=(format!("tag {outcome}")) { (outcome) } }
            td.cohort { (episode.cohort) }
            td.number { (text::count(episode.steps)) " " span.soft { (text::seconds(episode.duration_s)) } }
            td {
                @if episode.warnings > 0 { span.tag.warned { (text::counted(episode.warnings, "warning")) } }
                @else { span.soft { "clean" } }
            }
            td.number { @if let Some(q) = view.mean_q(row) { (format!("{q:.3}")) } @else { "–" } }
            td.labelled { span.by { (labelled_by) } " " span.at.soft { (text::time(*labelled_at)) } }
            td.arrived { (text::time(episode.created_at)) }
        }
    }
}
