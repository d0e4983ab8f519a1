//! Plots over time on one axis under the cameras: q with β and the kept segments, proprioception, action.

use gleaner_core::{
    TaskSpec, error::Kind, id::ScoreRunId, score::ScoreRun, selection::Filter, snapshot::Role, steps::Series,
};
use maud::{Markup, html};

use super::{Scored, View};
use crate::{
    episodes::describe,
    plot::{Frame, roomy},
    text,
};

/// The size of a plot in its own units; it scales with the page.
const WIDTH: f64 = 720.0;
const Q_HEIGHT: f64 = 170.0;
const HEIGHT: f64 = 120.0;
/// Colours of lines; further lines repeat them dashed.
const COLOURS: usize = 6;

/// The plots.
pub(super) fn timeline(view: &View, times: &[f64]) -> Markup {
    let read = (&view.task.spec, view.inspected.episode.mapping.as_str());
    html! {
        div.timeline {
            section aria-labelledby="q-head" {
                h2 #q-head { "Quality q" }
                @match &view.scored {
                    Some(scored) => (quality(view, scored, times)),
                    None => p.panel.empty {
                        "No finished score run has scored this episode. "
                        a href=(format!("/tasks/{}/runs", view.task.spec.name)) { "Score runs" }
                    },
                }
            }
            @match &view.numbers {
                Ok(numbers) => {
                    (panels("Proprioception", &numbers.proprioception, read, times))
                    (panels("Action", &numbers.action, read, times))
                }
                Err(error) if error.kind() == Kind::Internal => {
                    p.note.bad { "The steps of the recording cannot be read; see the server's log for the cause." }
                }
                Err(error) => p.note.bad { "The steps of the recording cannot be shown: " (error.message()) },
            }
        }
    }
}

fn quality(view: &View, scored: &Scored, times: &[f64]) -> Markup {
    let scores = &scored.scores;
    let stretches = kept(&scores.q, view.beta);
    let count: usize = stretches.iter().map(|(first, last)| last - first + 1).sum();
    let count = u64::try_from(count).unwrap_or(u64::MAX);
    let of = u64::try_from(scores.q.len()).unwrap_or(u64::MAX);
    html! {
        form.row.choose method="get" {
            input type="hidden" name="step" value=(view.step);
            label { "Run " (runs(&view.runs, &scored.run.id)) }
            label.beta { "β " input #beta type="range" min="0" max="1" step="0.005" value=(view.beta); }
            input #beta-number name="beta" type="number" min="0" max="1" step="any" value=(view.beta) aria-label="β";
            button #choose type="submit" { "Show" }
        }
        div.panel {
            (drawn(view, scores.q.as_slice(), &stretches, times))
            @if scores.role != Role::Expert {
                p.formats aria-live="polite" {
                    span #kept { (text::count(count)) " of " (text::counted(of, "segment")) " kept (" (text::share(count, of)) ")" }
                }
            }
        }
        p.formats {
            @if scores.role == Role::Expert {
                "This episode is an expert of the run: it is "
                @if scored.run.origin.job_id().is_some() { "compared with the other experts and " }
                "kept in full for every β. "
            }
            "Shading marks steps at which a kept segment ends (q > β). A segment covers that step and the "
            (text::counted(u64::from(scored.segment_length), "step")) " before. "
            a href=(format!("/runs/{}?beta={}", scored.run.id, view.beta)) { "The run" } ", "
            a href=(format!("/episodes/{}/scores.json?run={}", view.id(), scored.run.id)) { "these scores as JSON" }
        }
    }
}

fn runs(runs: &[ScoreRun], chosen: &ScoreRunId) -> Markup {
    html! {
        select #run name="run" {
            @for run in runs { option value=(run.id) selected[run.id == *chosen] { (describe(run)) } }
        }
    }
}

fn drawn(view: &View, q: &[f32], stretches: &[(usize, usize)], times: &[f64]) -> Markup {
    let frame = Frame::new((WIDTH, Q_HEIGHT), whole(times), (0.0, 1.0));
    let points: Vec<(f64, f64)> = times.iter().copied().zip(q.iter().map(|&q| f64::from(q))).collect();
    let inside = html! {
        g #shades { @for &stretch in stretches { (frame.stretch(bounds(stretch, times), "shade")) } }
        g #level { (frame.level(view.beta, "beta")) }
        (frame.line(&points, "c1"))
    };
    frame.draw("q over time, with β as a level line", ("s", "q"), &inside)
}

fn panels(title: &str, fields: &[Series], read: (&TaskSpec, &str), times: &[f64]) -> Markup {
    html! {
        @if !fields.is_empty() {
            section aria-label=(title) {
                h2 { (title) }
                div.panels { @for field in fields { (panel(field, read, times)) } }
            }
        }
    }
}

fn panel(field: &Series, read: (&TaskSpec, &str), times: &[f64]) -> Markup {
    let values = || field.values.iter().map(|&value| f64::from(value));
    let frame = Frame::new((WIDTH, HEIGHT), whole(times), roomy(values()));
    let dimension = |place: usize| -> Vec<(f64, f64)> {
        times.iter().copied().zip(values().skip(place).step_by(field.size.max(1))).collect()
    };
    let lines = html! { @for place in 0..field.size { (frame.line(&dimension(place), &colour(place))) } };
    html! {
        div.panel {
            div.row {
                h3 { (field.name) }
                @if field.size > 1 { (legend(field, read)) }
            }
            (frame.draw(&format!("{} over time", field.name), ("s", unit(&field.name, read.0)), &lines))
        }
    }
}

/// What the values of a field are measured in.
fn unit<'a>(field: &str, task: &'a TaskSpec) -> &'a str {
    let found = task.proprioception.iter().chain(&task.action).find(|known| known.name == field);
    found.map(|field| field.unit.as_str()).filter(|unit| !unit.is_empty()).unwrap_or("as recorded")
}

/// The legend: the line of each component of a field, by its name where the mapping by which it was read has names.
fn legend(field: &Series, (task, mapping): (&TaskSpec, &str)) -> Markup {
    let mut sources = task.mappings.iter().filter(|known| known.name == mapping).flat_map(|known| &known.fields);
    let source = sources.find(|source| source.field == field.name && source.names.len() == field.size);
    let name = |place: usize| match source {
        Some(source) => source.names[place].clone(),
        None => format!("[{place}]"),
    };
    html! {
        ul.legend { @for place in 0..field.size {
            li {
                svg viewBox="0 0 14 10" aria-hidden="true" { path class=(format!("line {}", colour(place))) d="M0 5H14" {} }
                (name(place))
            }
        } }
    }
}

fn colour(place: usize) -> String {
    format!("c{}{}", place % COLOURS + 1, if place < COLOURS { "" } else { " dashed" })
}

/// From the first step to the last.
fn whole(times: &[f64]) -> (f64, f64) {
    (times.first().copied().unwrap_or(0.0), times.last().copied().unwrap_or(0.0))
}

/// Ranges of steps at which kept segments end, each with its first and last.
fn kept(q: &[f32], beta: f64) -> Vec<(usize, usize)> {
    let filter = Filter::Above(beta);
    let mut stretches: Vec<(usize, usize)> = Vec::new();
    for (step, &q) in q.iter().enumerate() {
        if !filter.keeps(0.0, q) {
            continue;
        }
        match stretches.last_mut() {
            Some((_, last)) if *last + 1 == step => *last = step,
            _ => stretches.push((step, step)),
        }
    }
    stretches
}

/// From half-way to the previous step to half-way to the next.
fn bounds((first, last): (usize, usize), times: &[f64]) -> (f64, f64) {
    let at = |step: usize| times.get(step).copied().or(times.last().copied()).unwrap_or(0.0);
    ((at(first.saturating_sub(1)) + at(first)) / 2.0, (at(last) + at(last + 1)) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kept_segments_are_strictly_above_the_threshold() {
        let q = [0.9, 0.5, 0.51, 0.7, 0.2, 0.6];
        assert_eq!(kept(&q, 0.5), [(0, 0), (2, 3), (5, 5)]);
        assert_eq!(kept(&q, 0.0), [(0, 5)]);
        assert!(kept(&q, 0.9).is_empty() && kept(&[], 0.1).is_empty());
    }

    #[test]
    fn a_range_ends_half_way_to_its_neighbours() {
        let times = [0.0, 1.0, 3.0, 4.0];
        assert_eq!(bounds((1, 2), &times), (0.5, 3.5));
        assert_eq!(bounds((0, 3), &times), (0.0, 4.0));
        assert_eq!(bounds((0, 0), &[]), (0.0, 0.0));
    }

    #[test]
    fn lines_differ_in_colour_or_dashes() {
        let all: std::collections::HashSet<String> = (0..2 * COLOURS).map(colour).collect();
        assert_eq!(all.len(), 2 * COLOURS);
    }

    #[test]
    fn each_dimension_is_a_line() {
        let field = Series { name: "tool".into(), size: 2, values: vec![0.0, 5.0, 1.0, f32::NAN, 2.0, 7.0] };
        let mut task: TaskSpec = serde_json::from_str(
            r#"{"name": "t", "rate_hz": 5, "action": [{"name": "tool", "size": 2}],
                "mappings": [{"name": "m", "fields": [{"field": "tool", "topic": "/t"}]}]}"#,
        )
        .unwrap();
        let drawn = |task: &TaskSpec| panel(&field, (task, "m"), &[0.0, 0.1, 0.2]).into_string();
        let plain = drawn(&task);
        assert_eq!((plain.matches("class=\"line c1\"").count(), plain.matches("class=\"line c2\"").count()), (2, 2));
        assert!(plain.contains("[1]") && plain.contains("as recorded") && !plain.contains("NaN"));
        task.action[0].unit = "rad".into();
        task.mappings[0].fields[0].names = ["shoulder", "elbow"].map(String::from).into();
        let named = drawn(&task);
        assert!(named.contains("elbow") && named.contains("rad") && !named.contains("[1]"), "{named}");
        let other = panel(&field, (&task, "other"), &[0.0, 0.1, 0.2]).into_string();
        assert!(other.contains("[1]") && !other.contains("elbow"), "{other}");
    }
}
