//! Counts of a selection: in total, by cohort, by episode.

use std::cmp::Ordering;

use gleaner_core::{
    id::{EpisodeId, ScoreRunId},
    selection::{Kept, Selection, WhatIf},
};
use maud::{Markup, html};
use serde_json::{Value, json};

use super::query::{Key, Order, parameters};
use crate::{backend::RunSummary, link, sheet::Sheet, standing::Standings, text};

/// Episodes shown on the page; the table for programs has all.
pub(super) const SHOWN: usize = 200;

/// One episode under a selection.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Row {
    pub(super) episode: EpisodeId,
    pub(super) kept: u64,
    pub(super) of: u64,
    pub(super) mean_q: Option<f64>,
}

/// Every episode in this order; of equal ones the older first.
pub(super) fn rows(what: &WhatIf, summary: &dyn RunSummary, order: Order) -> Vec<Row> {
    first_rows(what, summary, order, usize::MAX)
}

/// The first `most` episodes in this order; of equal ones the older first. Of 100,000 episodes, most are only compared.
pub(super) fn first_rows(what: &WhatIf, summary: &dyn RunSummary, order: Order, most: usize) -> Vec<Row> {
    let by_q = order.key == Key::MeanQ;
    let mut rows: Vec<Keyed<'_>> = Vec::with_capacity(what.episodes.len());
    for (episode, kept, of) in &what.episodes {
        rows.push(Keyed { episode, kept: *kept, of: *of, mean_q: if by_q { summary.mean_q(episode) } else { None } });
    }
    sort(&mut rows, order, most);
    let row = |Keyed { episode, kept, of, .. }: Keyed<'_>| Row {
        mean_q: summary.mean_q(episode),
        episode: episode.clone(),
        kept,
        of,
    };
    rows.into_iter().take(most).map(row).collect()
}

/// What an episode is sorted by.
#[derive(Debug, Clone, Copy)]
struct Keyed<'a> {
    episode: &'a EpisodeId,
    kept: u64,
    of: u64,
    /// Only where it is the key.
    mean_q: Option<f64>,
}

/// Sorts the first `most` rows; the others come behind them in no order.
fn sort(rows: &mut [Keyed<'_>], Order { key, descending }: Order, most: usize) {
    let by_key = |a: &Keyed<'_>, b: &Keyed<'_>| match key {
        // a/b against c/d without dividing: a run may have episodes without segments.
        Key::Share => (a.kept * b.of.max(1)).cmp(&(b.kept * a.of.max(1))),
        Key::Kept => a.kept.cmp(&b.kept),
        Key::Segments => a.of.cmp(&b.of),
        Key::MeanQ => a.mean_q.unwrap_or(-1.0).total_cmp(&b.mean_q.unwrap_or(-1.0)),
    };
    let directed = |order: Ordering| if descending { order.reverse() } else { order };
    let compare = |a: &Keyed<'_>, b: &Keyed<'_>| directed(by_key(a, b)).then_with(|| a.episode.cmp(b.episode));
    if most < rows.len() {
        rows.select_nth_unstable_by(most, compare);
    }
    let first = most.min(rows.len());
    rows[..first].sort_unstable_by(compare);
}

/// The counts of all episodes together.
pub(crate) fn figures(what: &WhatIf) -> Markup {
    let Kept { segments, of_segments, episodes, of_episodes } = what.total;
    html! {
        dl.figures {
            div { dt { "Segments kept" } dd { (text::count(segments)) small { " of " (text::count(of_segments)) } } }
            div { dt { "Share kept" } dd { (text::share(segments, of_segments)) } }
            div { dt { "Episodes with kept segments" } dd { (text::count(episodes)) small { " of " (text::count(of_episodes)) } } }
            div {
                dt { "Lowest similarity kept" }
                dd { @match what.threshold { Some(w) => (format!("{w:.3}")), None => "–" } }
            }
        }
    }
}

/// A share as a small bar; the numbers stand beside it.
fn bar(part: u64, of: u64) -> Markup {
    #[expect(clippy::cast_precision_loss, reason = "for a picture")]
    let width = 100.0 * part as f64 / of.max(1) as f64;
    html! {
        svg.bar viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true" {
            rect.part x="0" y="0" width=(format!("{width:.2}")) height="8" {}
        }
    }
}

/// The counts by cohort.
pub(crate) fn cohorts(what: &WhatIf) -> Markup {
    html! {
        div.scroll { table {
            thead { tr {
                th { "Cohort" } th.wide { "Share kept" } th.number { "" } th.number { "Segments kept" } th.number { "Episodes" }
            } }
            tbody {
                @for (cohort, kept) in &what.cohorts {
                    tr {
                        td { @if cohort.is_empty() { span.soft { "none" } } @else { (cohort) } }
                        td.wide { (bar(kept.segments, kept.of_segments)) }
                        td.number { (text::share(kept.segments, kept.of_segments)) }
                        td.number { (text::count(kept.segments)) span.soft { " of " (text::count(kept.of_segments)) } }
                        td.number { (text::count(kept.episodes)) span.soft { " of " (text::count(kept.of_episodes)) } }
                    }
                }
            }
        } }
    }
}

/// The same as a table for programs.
pub(crate) fn cohort_sheet(name: String, what: &WhatIf) -> Sheet {
    let row = |(cohort, kept): (&String, &Kept)| {
        vec![
            json!(cohort),
            json!(kept.segments),
            json!(kept.of_segments),
            json!(kept.episodes),
            json!(kept.of_episodes),
        ]
    };
    let columns = &["cohort", "kept_segments", "segments", "kept_episodes", "episodes"];
    Sheet { name, columns, rows: what.cohorts.iter().map(row).collect() }
}

/// The counts of the first of `of` episodes, with links to sort them. A permanently deleted episode has no link.
pub(super) fn episodes(
    run: &ScoreRunId,
    selection: Selection,
    order: Order,
    (rows, of): (&[Row], usize),
    standings: &Standings,
) -> Markup {
    let here = format!("/runs/{run}?{}", parameters(selection));
    let head = |key: Key, name: &str| {
        let chosen = order.key == key;
        let next = Order { key, descending: !(chosen && order.descending) };
        let sorted = chosen.then_some(if order.descending { "descending" } else { "ascending" });
        html! { th.number aria-sort=[sorted] { a href=(format!("{here}&sort={}", next.word())) {
            (name) @if chosen { (if order.descending { " ↓" } else { " ↑" }) }
        } } }
    };
    html! {
        div.scroll.tall tabindex="0" role="region" aria-label="Episodes" { table {
            thead { tr {
                th { "Episode" } th.wide { "" } (head(Key::Share, "Share kept")) (head(Key::Kept, "Kept"))
                (head(Key::Segments, "Segments")) (head(Key::MeanQ, "Mean q"))
            } }
            tbody { @for row in rows { tr {
                @let page = standings.has_page(&row.episode).then(|| format!("/episodes/{}?run={run}", row.episode));
                td { (link::brief(row.episode.as_str(), page.as_deref())) (standings.tag(&row.episode)) }
                td.wide { (bar(row.kept, row.of)) }
                td.number { (text::share(row.kept, row.of)) }
                td.number { (text::count(row.kept)) }
                td.number { (text::count(row.of)) }
                td.number { @match row.mean_q { Some(q) => (format!("{q:.3}")), None => "–" } }
            } } }
        } }
        p.formats {
            @if of > rows.len() { "The first " (rows.len()) " of " (text::counted(of as u64, "episode")) ". " }
            "All as " a href=(format!("{here}&sort={}&format=json", order.word())) { "JSON" } " or "
            a href=(format!("{here}&sort={}&format=csv", order.word())) { "CSV" }
        }
    }
}

/// Every episode for programs.
pub(super) fn episode_sheet(run: &ScoreRunId, rows: Vec<Row>) -> Sheet {
    let row = |row: Row| vec![json!(row.episode), json!(row.kept), json!(row.of), json!(row.mean_q)];
    let columns = &["episode_id", "kept_segments", "segments", "mean_q"];
    Sheet { name: format!("{run}-kept"), columns, rows: rows.into_iter().map(row).collect() }
}

/// All counts, for programs.
pub(super) fn counts(run: &ScoreRunId, what: &WhatIf) -> Value {
    let group = |kept: &Kept| {
        json!({
            "kept_segments": kept.segments, "segments": kept.of_segments,
            "kept_episodes": kept.episodes, "episodes": kept.of_episodes,
        })
    };
    let cohort = |(name, kept): (&String, &Kept)| (name.clone(), group(kept));
    let episode =
        |(id, kept, of): &(EpisodeId, u64, u64)| json!({ "episode_id": id, "kept_segments": kept, "segments": of });
    json!({
        "score_run_id": run,
        "selection": what.selection,
        "lowest_similarity": what.threshold,
        "total": group(&what.total),
        "cohorts": what.cohorts.iter().map(cohort).collect::<serde_json::Map<_, _>>(),
        "by_episode": what.episodes.iter().map(episode).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(kept: u64, of: u64, mean_q: Option<f64>) -> Row {
        Row { episode: EpisodeId::new(), kept, of, mean_q }
    }

    #[test]
    fn shares_are_compared_exactly_and_ties_by_age() {
        let ids = [(); 4].map(|()| EpisodeId::new());
        let rows = [(1, 3, None), (2, 6, Some(0.5)), (0, 0, Some(0.1)), (3, 4, Some(0.9))];
        let keyed = || -> Vec<Keyed<'_>> {
            let keyed = |(episode, &(kept, of, mean_q))| Keyed { episode, kept, of, mean_q };
            ids.iter().zip(&rows).map(keyed).collect()
        };
        let sorted = |key, descending| {
            let (order, mut sorted) = (Order { key, descending }, keyed());
            sort(&mut sorted, order, 9);
            for most in 0..4 {
                let mut first = keyed();
                sort(&mut first, order, most);
                let ids = |rows: &[Keyed<'_>]| rows[..most].iter().map(|row| row.episode.clone()).collect::<Vec<_>>();
                assert_eq!(ids(&first), ids(&sorted), "{most}");
            }
            sorted.iter().map(|row| (row.kept, row.of)).collect::<Vec<_>>()
        };
        assert_eq!(sorted(Key::Share, true), [(3, 4), (1, 3), (2, 6), (0, 0)]);
        assert_eq!(sorted(Key::Share, false), [(0, 0), (1, 3), (2, 6), (3, 4)]);
        assert_eq!(sorted(Key::Kept, true)[0], (3, 4));
        assert_eq!(sorted(Key::Segments, false)[0], (0, 0));
        assert_eq!(sorted(Key::MeanQ, true), [(3, 4), (2, 6), (0, 0), (1, 3)]);
    }

    #[test]
    fn the_table_links_to_its_reverse_order_and_is_limited() {
        let (run, rows) = (ScoreRunId::new(), vec![row(1, 2, Some(0.25)); SHOWN]);
        let order = Order { key: Key::Share, descending: true };
        let shown = episodes(&run, Selection::beta(0.5), order, (&rows, 250), &Standings::default()).into_string();
        assert!(shown.contains("beta=0.5&amp;sort=share\"") && shown.contains("beta=0.5&amp;sort=-kept\""), "{shown}");
        assert!(shown.contains("The first 200 of 250 episodes") && shown.contains("format=csv"));
        assert_eq!(shown.matches("<tr>").count(), 201);
    }
}
