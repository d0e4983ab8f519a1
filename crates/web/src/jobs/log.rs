//! A job's log: its newest lines on the job's page, and all kept lines as text.

use axum::{extract::Path, http::header::CONTENT_TYPE, response::IntoResponse as _};
use gleaner_core::{Result, id::JobId};
use maud::{Markup, html};

use crate::{page_request::PageRequest, refusal::Answer};

/// Lines shown on the job's page, and the bytes searched for them.
const SHOWN: usize = 200;
pub(super) const LOOKED_AT: u64 = 48 << 10;

/// All kept lines, as text.
pub(crate) async fn show(request: PageRequest, Path(id): Path<String>) -> Answer {
    let backend = request.backend();
    let job = backend.job(&JobId::parse("id", &id)?).await?;
    let log = backend.job_log(&job.id, u64::MAX).await?;
    Ok(([(CONTENT_TYPE, "text/plain; charset=utf-8")], log).into_response())
}

/// The newest lines: the part of the page that a script updates.
pub(super) fn newest(job: &JobId, log: &Result<String>) -> Markup {
    html! {
        section #log-section aria-labelledby="log-head" {
            h2 #log-head { "Log" }
            @match log {
                Err(_) => p.note.bad { "The log cannot be read; see the server's own log for the cause." },
                Ok(log) if log.is_empty() => p.panel.empty { "The log is empty." },
                Ok(log) => (lines(job, last(log, SHOWN))),
            }
        }
    }
}

fn lines(job: &JobId, lines: &str) -> Markup {
    html! {
        div #log.panel.log tabindex="0" role="region" aria-label="Log, the newest lines" { pre { (lines) } }
        p.formats { "The newest lines, times in UTC. " a href=(format!("/jobs/{job}/log")) { "The whole stored log as text" } }
    }
}

/// The last lines of a text.
fn last(log: &str, most: usize) -> &str {
    let begin = log.trim_end_matches('\n').rmatch_indices('\n').nth(most - 1).map_or(0, |(at, _)| at + 1);
    log.get(begin..).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use gleaner_core::Error;

    use super::*;

    #[test]
    fn the_newest_lines_are_shown() {
        for (log, shown) in [("", ""), ("a\nb\n", "a\nb\n"), ("a\nb\nc\n", "b\nc\n"), ("a\nb\nc", "b\nc")] {
            assert_eq!(last(log, 2), shown);
        }
        let shown = newest(&JobId::new(), &Ok("<b>\n".repeat(SHOWN + 3))).into_string();
        assert!(shown.matches("&lt;b&gt;").count() == SHOWN && !shown.contains("<b>"));
        let shown = newest(&JobId::new(), &Err(Error::internal("reading", "denied"))).into_string();
        assert!(shown.contains("cannot be read"), "{shown}");
    }
}
