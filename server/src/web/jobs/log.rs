//! What a job's workers said: its newest lines on the job's page, and all that is kept as a page of its own.

use axum::{extract::Path, http::header::CONTENT_TYPE, response::IntoResponse as _};
use maud::{Markup, html};

use crate::{
    domain::id::JobId,
    error::Result,
    web::{page_request::PageRequest, refusal::Answer},
};

/// Lines that the job's page shows, and bytes that it looks for them in.
const SHOWN: usize = 200;
pub(super) const LOOKED_AT: u64 = 48 << 10;

/// All that is kept, as text.
pub(in crate::web) async fn show(request: PageRequest, Path(id): Path<String>) -> Answer {
    let services = request.services();
    let job = services.store.job(&JobId::parse("id", &id)?).await?;
    let said = services.jobs.log(&job.id, u64::MAX).await?;
    Ok(([(CONTENT_TYPE, "text/plain; charset=utf-8")], said).into_response())
}

/// The newest lines: the part of the page that a script adds to.
pub(super) fn newest(job: &JobId, said: &Result<String>) -> Markup {
    html! {
        section #said aria-labelledby="said-head" {
            h2 #said-head { "Log" }
            @match said {
                Err(_) => p.note.bad { "The log cannot be read; the server's own log says why." },
                Ok(said) if said.is_empty() => p.panel.empty { "Nothing was said yet." },
                Ok(said) => (lines(job, last(said, SHOWN))),
            }
        }
    }
}

fn lines(job: &JobId, lines: &str) -> Markup {
    html! {
        div #log.panel.log tabindex="0" role="region" aria-label="Log, the newest lines" { pre { (lines) } }
        p.formats { "The newest lines, times in UTC. " a href=(format!("/jobs/{job}/log")) { "All that is kept, as text" } }
    }
}

/// The last lines of a text.
fn last(said: &str, most: usize) -> &str {
    let begin = said.trim_end_matches('\n').rmatch_indices('\n').nth(most - 1).map_or(0, |(at, _)| at + 1);
    said.get(begin..).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;

    #[test]
    fn the_newest_lines_are_shown() {
        for (said, shown) in [("", ""), ("a\nb\n", "a\nb\n"), ("a\nb\nc\n", "b\nc\n"), ("a\nb\nc", "b\nc")] {
            assert_eq!(last(said, 2), shown);
        }
        let shown = newest(&JobId::new(), &Ok("<b>\n".repeat(SHOWN + 3))).into_string();
        assert!(shown.matches("&lt;b&gt;").count() == SHOWN && !shown.contains("<b>"));
        let shown = newest(&JobId::new(), &Err(Error::internal("reading", "denied"))).into_string();
        assert!(shown.contains("cannot be read"), "{shown}");
    }
}
