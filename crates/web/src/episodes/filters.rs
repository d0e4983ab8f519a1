//! The filter form over the table of episodes.

use gleaner_core::{episode::Outcome, score::ScoreRun};
use maud::{Markup, html};

use super::{View, query::NO_COHORT};
use crate::{link, text};

/// The form, filled in from the address.
pub(super) fn form(view: &View, runs: &[ScoreRun], cohorts: &[String]) -> Markup {
    let parameters = view.parameters;
    let outcomes = [Outcome::Success, Outcome::Failure, Outcome::Unknown].map(|outcome| {
        let word = outcome.as_str();
        (word.to_owned(), word.to_owned())
    });
    html! {
        form.filters method="get" role="search" aria-label="Filter episodes" {
            (choice(("outcome", "Outcome"), &parameters.outcome, "any", &outcomes))
            (choice(("cohort", "Cohort"), &parameters.cohort, "any", &cohort_choices(&parameters.cohort, cohorts)))
            (choice(("findings", "Report"), &parameters.findings, "any", &[
                ("some".to_owned(), "with warnings".to_owned()), ("none".to_owned(), "without".to_owned()),
            ]))
            label { "From (UTC)" input type="date" name="from" value=(parameters.from); }
            label { "To (UTC)" input type="date" name="to" value=(parameters.to); }
            label { "Name or id" input type="search" name="text" value=(parameters.text) maxlength="255"; }
            @if !runs.is_empty() {
                (choice(("run", "q of run"), &parameters.run, "the newest", &run_choices(runs)))
                label { "Mean q from" (number("q_from", &parameters.q_from)) }
                label { "to" (number("q_to", &parameters.q_to)) }
            }
            @if !parameters.sort.is_empty() { input type="hidden" name="sort" value=(parameters.sort); }
            button.primary type="submit" { "Filter" }
            @if view.request.uri.query().is_some_and(|query| !query.is_empty()) {
                a.button href=(view.request.uri.path()) { "Clear" }
            }
        }
    }
}

/// A list of choices; the first one is no filter.
fn choice((name, title): (&str, &str), chosen: &str, none: &str, choices: &[(String, String)]) -> Markup {
    html! {
        label { (title)
            select name=(name) {
                option value="" selected[chosen.is_empty()] { (none) }
                @for (value, text) in choices {
                    option value=(value) selected[value == chosen] { (text) }
                }
            }
        }
    }
}

fn number(name: &str, value: &str) -> Markup {
    html! { input type="number" name=(name) value=(value) min="0" max="1" step="any" inputmode="decimal"; }
}

/// Every cohort of the task, and the chosen one even without episodes.
fn cohort_choices(chosen: &str, cohorts: &[String]) -> Vec<(String, String)> {
    let value = |cohort: &String| if cohort.is_empty() { NO_COHORT.to_owned() } else { cohort.clone() };
    let mut choices: Vec<(String, String)> = cohorts.iter().map(|cohort| (value(cohort), value(cohort))).collect();
    if !chosen.is_empty() && choices.iter().all(|(value, _)| value != chosen) {
        choices.push((chosen.to_owned(), chosen.to_owned()));
    }
    choices
}

fn run_choices(runs: &[ScoreRun]) -> Vec<(String, String)> {
    runs.iter().map(|run| (run.id.to_string(), describe(run))).collect()
}

/// The description of a run in a list.
pub(crate) fn describe(run: &ScoreRun) -> String {
    format!("{} UTC · {} · {}", text::time(run.created_at), run.origin.scorer(), link::short(run.id.as_str()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chosen_cohort_is_listed_even_without_episodes() {
        let choices = cohort_choices("gone", &[String::new(), "weak".to_owned()]);
        let values: Vec<&str> = choices.iter().map(|(value, _)| value.as_str()).collect();
        assert_eq!(values, [NO_COHORT, "weak", "gone"]);
    }
}
