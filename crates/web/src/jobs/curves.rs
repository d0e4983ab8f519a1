//! A job's metrics as curves: one plot per family of metrics.

use std::collections::BTreeMap;

use gleaner_core::{job::Metric, looks};
use maud::{Markup, html};

use crate::plot::{Frame, range, roomy};

/// (step, value), in order.
type Points = Vec<(f64, f64)>;

/// One metric's values over steps.
pub(super) struct Curve<'a> {
    name: &'a str,
    points: Points,
}

/// Metrics in one plot: those whose names begin with the same word.
pub(super) struct Family<'a> {
    word: &'a str,
    curves: Vec<Curve<'a>>,
}

/// The families, losses first.
pub(super) fn families(metrics: &[Metric]) -> Vec<Family<'_>> {
    let mut curves: BTreeMap<&str, BTreeMap<&str, Points>> = BTreeMap::new();
    // What a policy looks at is one value, shown with the policy.
    for metric in metrics.iter().filter(|metric| !metric.name.starts_with(looks::PREFIX)) {
        let word = metric.name.split('_').next().unwrap_or_default();
        #[expect(clippy::cast_precision_loss, reason = "far fewer than 2^52 steps")]
        let point = (metric.step as f64, metric.value);
        curves.entry(word).or_default().entry(&metric.name).or_default().push(point);
    }
    let family = |(word, curves): (_, BTreeMap<_, _>)| Family {
        word,
        curves: curves.into_iter().map(|(name, points)| Curve { name, points }).collect(),
    };
    let mut families: Vec<Family> = curves.into_iter().map(family).collect();
    families.sort_by_key(|family| family.word != "loss");
    families
}

/// One family's plot.
pub(super) fn panel(family: &Family) -> Markup {
    let name = match family.curves.as_slice() {
        [only] => only.name,
        _ => family.word,
    };
    let points = || family.curves.iter().flat_map(|curve| curve.points.iter().copied());
    let steps = range(points().map(|point| point.0));
    // Losses and times start at zero, so that a curve that is flat far above zero looks flat.
    let against_nothing = points().all(|(_, value)| value >= 0.0).then_some(0.0);
    let values = roomy(points().map(|point| point.1).chain(against_nothing));
    let values = (against_nothing.unwrap_or(values.0), values.1);
    let frame = Frame::new((600.0, 220.0), steps, values);
    let inside = html! {
        @for (curve, class) in family.curves.iter().zip(1_usize..) {
            (frame.line(&curve.points, &format!("c{}", (class - 1) % 6 + 1)))
        }
    };
    html! {
        figure.panel {
            figcaption { (name) }
            (frame.draw(&format!("{name} over steps"), ("step", ""), &inside))
            ul.legend { @for (curve, class) in family.curves.iter().zip(1_usize..) {
                li {
                    svg viewBox="0 0 14 10" aria-hidden="true" {
                        line class=(format!("line c{}", (class - 1) % 6 + 1)) x1="0" x2="14" y1="5" y2="5" {}
                    }
                    (curve.name)
                    @if let Some((_, last)) = curve.points.last() { " " b { (short(*last)) } }
                }
            } }
        }
    }
}

/// A value in few digits.
fn short(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e5).contains(&value.abs()) { format!("{value:.2e}") } else { format!("{value:.4}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metric(step: u64, name: &str, value: f64) -> Metric {
        Metric { sequence: 0, step, name: name.into(), value }
    }

    #[test]
    fn losses_are_drawn_together_and_first() {
        let metrics =
            [metric(1, "grad_norm", 3.0), metric(1, "loss", 2.0), metric(1, "loss_mtp", 1.5), metric(2, "loss", 1.0)];
        let families = families(&metrics);
        assert_eq!(families.iter().map(|family| family.word).collect::<Vec<_>>(), ["loss", "grad"]);
        let drawn = panel(&families[0]).into_string();
        assert!(drawn.contains("loss_mtp") && drawn.contains("<b>1.0000</b>"), "{drawn}");
        assert_eq!(drawn.matches("<path").count(), 2);
        assert!(panel(&families[1]).into_string().contains("<figcaption>grad_norm<"), "alone it has its own name");
        assert!(super::families(&[]).is_empty());
    }
}
