//! What a job's workers said: its newest lines on the job's page, and all that is kept as a page of its own.

use axum::{extract::Path, http::header::CONTENT_TYPE, response::IntoResponse as _};
use maud::{Markup, html};

use crate::{
    domain::id::JobId,
    web::{refusal::Answer, say, visit::Visit},
};

/// Lines that the job's page shows.
const SHOWN: usize = 200;

/// All that is kept, as text.
pub(in crate::web) async fn show(visit: Visit, Path(id): Path<String>) -> Answer {
    let rooms = visit.rooms();
    let job = rooms.store.job(&JobId::parse("id", &id)?).await?;
    let said = rooms.jobs.log(&job.id).await?;
    Ok(([(CONTENT_TYPE, "text/plain; charset=utf-8")], said).into_response())
}

/// The newest lines.
pub(super) fn newest(job: &JobId, said: &str) -> Markup {
    let (earlier, lines) = last(said, SHOWN);
    html! {
        h2 { "Log" }
        @if lines.is_empty() {
            p.panel.empty { "Nothing was said yet." }
        } @else {
            div #log.panel.log tabindex="0" role="region" aria-label="Log, the newest lines" { pre { (lines) } }
            p.formats {
                @if earlier > 0 { "After " (say::counted(earlier, "earlier line")) ". " }
                a href=(format!("/jobs/{job}/log")) { "All that is kept, as text" } ", times in UTC"
            }
        }
    }
}

/// The last lines of a text, and how many are before them.
fn last(said: &str, most: usize) -> (u64, &str) {
    let begin = said.trim_end_matches('\n').rmatch_indices('\n').nth(most - 1).map_or(0, |(at, _)| at + 1);
    let (earlier, lines) = said.split_at(begin);
    (earlier.matches('\n').count() as u64, lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_lines_are_shown_and_the_others_counted() {
        assert_eq!(last("", 2), (0, ""));
        assert_eq!(last("a\nb\n", 2), (0, "a\nb\n"));
        assert_eq!(last("a\nb\nc\n", 2), (1, "b\nc\n"));
        assert_eq!(last("a\nb\nc", 2), (1, "b\nc"));
        let shown = newest(&JobId::new(), &"<b>\n".repeat(SHOWN + 3)).into_string();
        assert!(shown.contains("After 3 earlier lines") && shown.contains("&lt;b&gt;") && !shown.contains("<b>"));
    }
}
