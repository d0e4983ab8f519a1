//! The histogram of q with the threshold, and the experts beside it.

use gleaner_core::{
    score::{Histogram, legible_height},
    selection::{ExpertRanking, Rule},
};
use maud::{Markup, html};

use crate::{plot::Frame, text};

/// Bins of the histogram: the slider stops between them.
pub(super) const BINS: usize = 100;

/// Bins that one step of a line covers: experts and cohorts have fewer segments.
const MERGED: usize = 5;

/// Cohorts with a line of their own at most; the largest come first.
const COHORTS: usize = 6;

/// Imperfect segments by q as bars, of which those that the rule keeps whole are highlighted; those of experts and, where there
/// are several cohorts, of the largest as lines, each scaled to the same number of segments.
pub(super) fn histogram(histogram: &Histogram, rule: Rule) -> Markup {
    let heights = heights(histogram.counts());
    let all = heights.iter().sum::<f64>().max(1.0);
    let experts = Some(histogram.expert_counts()).filter(|counts| counts.iter().any(|count| *count > 0));
    let experts = experts.map(|counts| scaled(counts, all));
    let mut cohorts = histogram.cohorts(COHORTS);
    // A single cohort is that of the bars.
    cohorts.retain(|(_, counts)| *counts != histogram.counts());
    let cohorts: Vec<(&str, Vec<f64>)> =
        cohorts.into_iter().map(|(cohort, counts)| (cohort, scaled(counts, all))).collect();
    let bins = f64::from(u32::try_from(heights.len()).unwrap_or(u32::MAX));
    let drawn = heights.iter().chain(experts.iter().flatten()).chain(cohorts.iter().flat_map(|(_, line)| line));
    let most = drawn.copied().fold(1.0, f64::max);
    let cut = legible_height(&heights).filter(|cut| *cut < most);
    let highest = 1.05 * cut.unwrap_or(most);
    let within = |line: &[f64]| stairs(&line.iter().map(|height| height.min(highest)).collect::<Vec<_>>());
    let frame = Frame::new((920.0, 260.0), (0.0, 1.0), (0.0, highest));
    let beta = match rule {
        Rule::Beta(beta) => Some(beta),
        Rule::TopFraction(_) => None,
    };
    let class = |from: f64| if beta.is_some_and(|beta| from >= beta - 1e-9) { "q kept" } else { "q" };
    let inside = html! {
        @for (from, &height) in (0_u32..).map(|bin| f64::from(bin) / bins).zip(&heights) {
            (frame.bar((from, from + 1.0 / bins), height.min(highest), class(from)))
        }
        @for (place, (_, line)) in (1..).zip(&cohorts) { (frame.line(&within(line), &colour(place))) }
        @if let Some(experts) = &experts { (frame.line(&within(experts), "experts")) }
        @if let Some(beta) = beta {
            line.beta x1=(frame.x(beta)) x2=(frame.x(beta)) y1=(frame.y(0.0)) y2=(frame.y(highest)) {}
        }
    };
    let title = "Histogram of q over all imperfect segments, and over those of experts and of cohorts";
    html! {
        (frame.draw(title, ("q", "segments"), &inside))
        @if experts.is_some() || !cohorts.is_empty() {
            ul.legend {
                @if experts.is_some() { (entry("experts", "experts")) }
                @for (place, (cohort, _)) in (1..).zip(&cohorts) { (entry(&colour(place), cohort)) }
            }
        }
        p.soft {
            "Bars: imperfect segments."
            @if let Some(lines) = lines(experts.is_some(), cohorts.len()) {
                " Lines: segments of " (lines) ", each scaled to the same number."
            }
            @if let Some(cut) = cut { " What is higher than " (text::count(rounded(cut))) " segments is cut off." }
        }
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of segments")]
fn rounded(height: f64) -> u64 {
    height.round() as u64
}

/// What the lines are of; `None` without any.
fn lines(experts: bool, cohorts: usize) -> Option<&'static str> {
    match (experts, cohorts) {
        (false, 0) => None,
        (true, 0) => Some("experts"),
        (false, COHORTS) => Some("the largest cohorts"),
        (true, COHORTS) => Some("experts and of the largest cohorts"),
        (false, _) => Some("cohorts"),
        (true, _) => Some("experts and of cohorts"),
    }
}

/// The class of a line's colour, from 1.
fn colour(place: usize) -> String {
    format!("c{place}")
}

/// A line of the legend.
fn entry(class: &str, name: &str) -> Markup {
    html! {
        li {
            svg viewBox="0 0 14 10" aria-hidden="true" { path class=(format!("line {class}")) d="M0 5H14" {} }
            @if name.is_empty() { span.soft { "none" } } @else { (name) }
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "for a picture")]
fn heights(counts: &[u64]) -> Vec<f64> {
    counts.iter().map(|&count| count as f64).collect()
}

/// Counts as a line of fewer bins, with as many segments as the bars have.
fn scaled(counts: &[u64], all: f64) -> Vec<f64> {
    let heights = heights(counts);
    let scale = all / heights.iter().sum::<f64>().max(1.0);
    heights.chunks(MERGED).map(|bins| scale * mean(bins)).collect()
}

#[expect(clippy::cast_precision_loss, reason = "a few bins")]
fn mean(heights: &[f64]) -> f64 {
    heights.iter().sum::<f64>() / heights.len() as f64
}

/// The outline of bars over 0 to 1.
fn stairs(heights: &[f64]) -> Vec<(f64, f64)> {
    let bins = f64::from(u32::try_from(heights.len()).unwrap_or(u32::MAX));
    let places = (0_u32..).map(|bin| f64::from(bin) / bins);
    heights.iter().zip(places).flat_map(|(height, from)| [(from, *height), (from + 1.0 / bins, *height)]).collect()
}

/// The share of pairs in which q ranks the expert higher, of each cohort too, with the warnings about it.
pub(super) fn separation(ranking: &ExpertRanking) -> Markup {
    let Some(all) = ranking.all else { return html! {} };
    let percent = |share: f64| format!("{:.0}\u{a0}%", 100.0 * share);
    let of_cohort = |(cohort, share): &(String, f64)| {
        let name = if cohort.is_empty() { "none" } else { cohort };
        format!("{name} {}", percent(*share))
    };
    let cohorts: Vec<String> = ranking.cohorts.iter().map(of_cohort).collect();
    html! {
        p.soft { "In " (percent(all))
            " of pairs the expert's segment has the higher q (ties count half)"
            @if cohorts.len() > 1 { "; by cohort: " (cohorts.join(", ")) } "." }
        @for warning in ranking.warnings(0.0) {
            p.note.bad { "Warning: " (warning) "." }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_cohorts_are_lines_with_as_many_segments_as_the_bars() {
        let mut run = Histogram::new(BINS, &[]);
        for cohort in 0..8_u8 {
            run.add(&format!("<{cohort}>"), std::iter::repeat_n(f32::from(cohort) / 8.0, 1 + usize::from(cohort)));
        }
        let drawn = histogram(&run, Rule::Beta(0.5)).into_string();
        assert_eq!(drawn.matches("<li>").count(), 6);
        assert!(drawn.contains("&lt;2&gt;") && !drawn.contains("&lt;1&gt;"), "{drawn}");
        assert!(
            (1..=6).all(|place| drawn.matches(&format!("line c{place}\"")).count() == 2) && !drawn.contains("line c7")
        );
        let of_line = |(_, counts): &(&str, &[u64])| scaled(counts, 36.0).iter().sum::<f64>() * 5.0;
        assert!(drawn.contains("Lines: segments of the largest cohorts, each"), "{drawn}");
        assert!(run.cohorts(COHORTS).iter().all(|cohort| (of_line(cohort) - 36.0).abs() < 1e-9));
    }

    #[test]
    fn bins_above_the_threshold_are_kept() {
        let mut even = Histogram::new(10, &[]);
        even.add("", (0..30_u8).map(|segment| f32::from(segment % 10) / 10.0 + 0.05));
        let drawn = histogram(&even, Rule::Beta(0.7)).into_string();
        assert_eq!(drawn.matches("class=\"q kept\"").count(), 3);
        assert_eq!(drawn.matches("class=\"q\"").count(), 7);
        assert_eq!(drawn.matches("class=\"beta\"").count(), 1);
        assert!(!drawn.contains("line experts") && separation(&ExpertRanking::default()).into_string().is_empty());
        let drawn = histogram(&Histogram::new(10, &[]), Rule::TopFraction(0.5)).into_string();
        assert!(!drawn.contains("legend") && !drawn.contains("Lines"), "{drawn}");
        assert!(!drawn.contains("kept") && !drawn.contains("class=\"beta\"") && !drawn.contains("NaN"));
    }

    #[test]
    fn bars_that_would_hide_the_others_are_cut_off() {
        let mut run = Histogram::new(BINS, &[]);
        run.add("", (0..300_u16).map(|segment| f32::from(segment % 100) / 100.0 + 0.005));
        let even = histogram(&run, Rule::Beta(0.5)).into_string();
        assert!(!even.contains("cut off"), "{even}");
        run.add("", std::iter::repeat_n(0.0, 5000));
        let drawn = histogram(&run, Rule::Beta(0.5)).into_string();
        assert!(drawn.contains("What is higher than 12 segments is cut off."), "{drawn}");
        // The top of the plot, and nothing above it.
        assert!(!drawn.contains("y=\"-") && drawn.contains("y=\"20"), "{drawn}");
    }

    #[test]
    fn experts_are_a_line_with_a_warning_if_they_do_not_score_higher() {
        let mut run = Histogram::new(10, &[]);
        run.add("late", [0.2, 0.5].into_iter());
        run.add_expert([0.9].into_iter());
        let drawn = histogram(&run, Rule::Beta(0.5)).into_string();
        assert_eq!(drawn.matches("line experts").count(), 2, "the line and its legend");
        assert!(!drawn.contains("line c1"), "a single cohort is that of the bars");
        assert!(drawn.contains("Lines: segments of experts, each"), "{drawn}");
        run.add("", [0.1].into_iter());
        let drawn = histogram(&run, Rule::Beta(0.5)).into_string();
        assert!(drawn.contains("experts and of cohorts") && drawn.contains(">none<"), "{drawn}");
        let ranking = |all, cohorts: &[(&str, f64)]| {
            let cohorts = cohorts.iter().map(|(name, share)| ((*name).to_owned(), *share)).collect();
            separation(&ExpertRanking { all: Some(all), cohorts }).into_string()
        };
        let shown = ranking(0.63, &[("late", 0.7), ("wrong", 0.56)]);
        assert!(
            shown.contains("63\u{a0}%") && shown.contains("by cohort: late 70\u{a0}%, wrong 56\u{a0}%."),
            "{shown}"
        );
        assert!(!shown.contains("Warning"), "{shown}");
        let shown = ranking(0.63, &[("", 0.7), ("wrong", 0.56)]);
        assert!(shown.contains("by cohort: none 70\u{a0}%, wrong"), "{shown}");
        assert!(ranking(0.49, &[("late", 0.49)]).contains("favour imperfect episodes"));
        assert!(ranking(0.6, &[("late", 0.7), ("wrong", 0.5)]).contains("hardly tell cohort &quot;wrong&quot;"));
    }
}
