//! Success rates of a policy with their confidence intervals.

use gleaner_core::{
    evaluation::{Evaluation, Success},
    policy::Policy,
};
use maud::{Markup, html};
use serde_json::json;

use crate::{
    link,
    page_request::PageRequest,
    sheet::{self, Sheet},
    text,
};

/// `62.0 % (55.1 to 68.4)` of the attempts.
pub(crate) fn rate(success: &Success) -> String {
    let (low, high) = success.interval;
    format!("{:.1} % ({:.1} to {:.1})", success.rate * 100.0, low * 100.0, high * 100.0)
}

/// A rate with its interval, from 0 to 1.
fn whisker(success: &Success) -> Markup {
    let at = |rate: f64| format!("{:.1}", 4.0 + 192.0 * rate.clamp(0.0, 1.0));
    let (low, high) = success.interval;
    html! {
        svg.whisker viewBox="0 0 200 16" role="img" aria-label=(rate(success)) {
            line.axis x1="4" x2="196" y1="8" y2="8" {}
            line.c1 x1=(at(low)) x2=(at(high)) y1="8" y2="8" {}
            circle.f1 cx=(at(success.rate)) cy="8" r="4" {}
        }
    }
}

/// The evaluations; without any, the command that makes one.
pub(super) fn section(request: &PageRequest, tried: &[Evaluation], command: &str) -> Markup {
    html! {
        @if tried.is_empty() {
            p.panel.empty { "Not evaluated yet. " code { (command) } " runs trials in the simulator; others are reported with "
                code { "ReportEvaluation" } "." }
        } @else {
            (table(tried))
            (sheet::links(request))
        }
    }
}

/// A policy's evaluations.
fn table(evaluations: &[Evaluation]) -> Markup {
    html! {
        div.scroll { table {
            thead { tr {
                th { "Where" } th.number { "Succeeded" } th.number { "Rate (95 %)" } th.wide { "0 to 100 %" }
                th.number { "Seeds" } th { "By" } th { "When (UTC)" }
            } }
            tbody { @for evaluation in evaluations {
                @let success = evaluation.success();
                tr {
                    td { (evaluation.simulation) }
                    td.number { (success.successes) span.soft { " of " (success.episodes) } }
                    td.number { (rate(&success)) }
                    td.wide { (whisker(&success)) }
                    td.number { (evaluation.seeds.len()) }
                    td { @match &evaluation.job_id {
                        Some(job) => (link::brief(job.as_str(), Some(&format!("/jobs/{job}")))),
                        None => "a report",
                    } }
                    td.when { (text::time(evaluation.created_at)) }
                }
            } }
        } }
    }
}

/// The same as a table for programs.
pub(super) fn sheet(policy: &Policy, evaluations: &[Evaluation]) -> Sheet {
    let row = |evaluation: &Evaluation| {
        let success = evaluation.success();
        vec![
            json!(evaluation.id),
            json!(evaluation.simulation),
            json!(success.successes),
            json!(success.episodes),
            json!(success.rate),
            json!(success.interval.0),
            json!(success.interval.1),
            json!(evaluation.job_id),
            json!(text::stamp(evaluation.created_at)),
        ]
    };
    let columns =
        &["evaluation_id", "simulation", "successes", "episodes", "rate", "low", "high", "job_id", "created_at"];
    Sheet { name: format!("{}-evaluations", policy.id), columns, rows: evaluations.iter().map(row).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_shown_with_its_interval() {
        let success = Success { episodes: 200, successes: 124, rate: 0.62, interval: (0.5511, 0.6844) };
        assert_eq!(rate(&success), "62.0 % (55.1 to 68.4)");
        let drawn = whisker(&success).into_string();
        assert!(drawn.contains("cx=\"123.0\"") && drawn.contains("x1=\"109.8\""), "{drawn}");
    }
}
