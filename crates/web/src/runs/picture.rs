//! The histogram of q with the threshold, and the experts beside it.

use gleaner_core::{
    score::{ExpertRanking, Histogram},
    selection::Rule,
};
use maud::{Markup, html};

use crate::plot::Frame;

/// Bins of the histogram: the slider stops between them.
pub(super) const BINS: usize = 100;

/// Bins that one step of the experts' line covers: there are fewer experts.
const MERGED: usize = 5;

/// Imperfect segments by q as bars, of which those that the rule keeps whole are highlighted, and the experts' segments as a
/// line, scaled to the same number of segments.
pub(super) fn histogram(histogram: &Histogram, rule: Rule) -> Markup {
    #[expect(clippy::cast_precision_loss, reason = "for a picture")]
    let heights = |counts: &[u64]| counts.iter().map(|&count| count as f64).collect::<Vec<f64>>();
    let (heights, experts) = (heights(histogram.counts()), heights(histogram.expert_counts()));
    let sum = |heights: &[f64]| heights.iter().sum::<f64>().max(1.0);
    let scale = sum(&heights) / sum(&experts);
    let experts: Vec<f64> = experts.chunks(MERGED).map(|bins| scale * mean(bins)).collect();
    let bins = f64::from(u32::try_from(heights.len()).unwrap_or(u32::MAX));
    let highest = 1.05 * heights.iter().chain(&experts).copied().fold(1.0, f64::max);
    let frame = Frame::new((920.0, 260.0), (0.0, 1.0), (0.0, highest));
    let beta = match rule {
        Rule::Beta(beta) => Some(beta),
        Rule::TopFraction(_) => None,
    };
    let class = |from: f64| if beta.is_some_and(|beta| from >= beta - 1e-9) { "q kept" } else { "q" };
    let inside = html! {
        @for (from, &height) in (0_u32..).map(|bin| f64::from(bin) / bins).zip(&heights) {
            (frame.bar((from, from + 1.0 / bins), height, class(from)))
        }
        @if histogram.expert_counts().iter().any(|count| *count > 0) {
            (frame.line(&stairs(&experts), "experts"))
        }
        @if let Some(beta) = beta {
            line.beta x1=(frame.x(beta)) x2=(frame.x(beta)) y1=(frame.y(0.0)) y2=(frame.y(highest)) {}
        }
    };
    frame.draw("Histogram of q over all imperfect segments, and over those of experts", ("q", "segments"), &inside)
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
    let cohorts: Vec<String> =
        ranking.cohorts.iter().map(|(cohort, share)| format!("{cohort} {}", percent(*share))).collect();
    html! {
        p.soft { "Bars: imperfect segments. Line: segments of experts, scaled to the same number. In " (percent(all))
            " of pairs the expert's segment has the higher q (ties count half)"
            @if cohorts.len() > 1 { "; by cohort: " (cohorts.join(", ")) } "." }
        @for warning in ranking.warnings() {
            p.note.bad { "Warning: " (warning) "." }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_above_the_threshold_are_kept() {
        let mut even = Histogram::new(10, &[]);
        even.add((0..30_u8).map(|segment| f32::from(segment % 10) / 10.0 + 0.05));
        let drawn = histogram(&even, Rule::Beta(0.7)).into_string();
        assert_eq!(drawn.matches("class=\"q kept\"").count(), 3);
        assert_eq!(drawn.matches("class=\"q\"").count(), 7);
        assert_eq!(drawn.matches("class=\"beta\"").count(), 1);
        assert!(!drawn.contains("line experts") && separation(&ExpertRanking::default()).into_string().is_empty());
        let drawn = histogram(&Histogram::new(10, &[]), Rule::TopFraction(0.5)).into_string();
        assert!(!drawn.contains("kept") && !drawn.contains("class=\"beta\"") && !drawn.contains("NaN"));
    }

    #[test]
    fn experts_are_a_line_with_a_warning_if_they_do_not_score_higher() {
        let mut run = Histogram::new(10, &[]);
        run.add([0.2, 0.5].into_iter());
        run.add_expert([0.9].into_iter());
        let drawn = histogram(&run, Rule::Beta(0.5)).into_string();
        assert_eq!(drawn.matches("line experts").count(), 1);
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
        assert!(ranking(0.49, &[("late", 0.49)]).contains("favour imperfect episodes"));
        assert!(ranking(0.6, &[("late", 0.7), ("wrong", 0.5)]).contains("hardly tell cohort wrong"));
    }
}
