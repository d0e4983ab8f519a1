//! The histogram of q with the threshold.

use gleaner_core::selection::Selection;
use maud::{Markup, html};

use crate::plot::Frame;

/// Bins of the histogram: the slider stops between them.
pub(super) const BINS: usize = 100;

/// Segments by q; bins that are kept whole are highlighted.
pub(super) fn histogram(counts: &[u64], selection: Selection) -> Markup {
    #[expect(clippy::cast_precision_loss, reason = "for a picture")]
    let (heights, bins): (Vec<f64>, f64) = (counts.iter().map(|&count| count as f64).collect(), counts.len() as f64);
    let highest = 1.05 * heights.iter().copied().fold(1.0, f64::max);
    let frame = Frame::new((920.0, 260.0), (0.0, 1.0), (0.0, highest));
    let beta = match selection {
        Selection::Beta(beta) => Some(beta),
        Selection::TopFraction(_) => None,
    };
    let class = |from: f64| if beta.is_some_and(|beta| from >= beta - 1e-9) { "q kept" } else { "q" };
    let inside = html! {
        @for (from, &height) in (0_u32..).map(|bin| f64::from(bin) / bins).zip(&heights) {
            (frame.bar((from, from + 1.0 / bins), height, class(from)))
        }
        @if let Some(beta) = beta {
            line.beta x1=(frame.x(beta)) x2=(frame.x(beta)) y1=(frame.y(0.0)) y2=(frame.y(highest)) {}
        }
    };
    frame.draw("Histogram of q over all imperfect segments", ("q", "segments"), &inside)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_above_the_threshold_are_kept() {
        let drawn = histogram(&[3; 10], Selection::Beta(0.7)).into_string();
        assert_eq!(drawn.matches("class=\"q kept\"").count(), 3);
        assert_eq!(drawn.matches("class=\"q\"").count(), 7);
        assert_eq!(drawn.matches("class=\"beta\"").count(), 1);
        let drawn = histogram(&[0; 10], Selection::TopFraction(0.5)).into_string();
        assert!(!drawn.contains("kept") && !drawn.contains("class=\"beta\"") && !drawn.contains("NaN"));
    }
}
