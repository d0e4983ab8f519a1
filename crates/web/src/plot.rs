//! Small plots as SVG: axes with units, lines, bars. Colours come from the style sheet, for light and dark themes.
//!
//! A plot is drawn in its own units and scales with the page; scripts that add a cursor find the data's position in
//! `data-left`, `data-right`, `data-from` and `data-to`.

use maud::{Markup, html};

/// Space for the numbers beside and below.
const LEFT: f64 = 46.0;
const BOTTOM: f64 = 34.0;
const TOP: f64 = 20.0;
const RIGHT: f64 = 12.0;

/// A plot's frame: its size, and the ranges of its axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    width: f64,
    height: f64,
    x: (f64, f64),
    y: (f64, f64),
}

impl Frame {
    /// A frame of this size over these ranges. An empty range is widened.
    pub(super) fn new(size: (f64, f64), x: (f64, f64), y: (f64, f64)) -> Self {
        Self { width: size.0, height: size.1, x: widened(x), y: widened(y) }
    }

    /// The horizontal position of a value.
    pub(super) fn x(&self, value: f64) -> f64 {
        LEFT + (value - self.x.0) / (self.x.1 - self.x.0) * (self.width - LEFT - RIGHT)
    }

    /// The vertical position of a value.
    pub(super) fn y(&self, value: f64) -> f64 {
        let part = (value - self.y.0) / (self.y.1 - self.y.0);
        self.height - BOTTOM - part * (self.height - BOTTOM - TOP)
    }

    /// The plot: axes with these labels, which include the units, and `inside` over them.
    pub(super) fn draw(&self, title: &str, labels: (&str, &str), inside: &Markup) -> Markup {
        let (left, right, top, bottom) = (LEFT, self.width - RIGHT, TOP, self.height - BOTTOM);
        let across = ticks(self.x.0, self.x.1, 8);
        let up = ticks(self.y.0, self.y.1, 4);
        html! {
            svg.plot viewBox=(format!("0 0 {} {}", self.width, self.height)) role="img" aria-label=(title)
                data-left=(left) data-right=(right) data-from=(self.x.0) data-to=(self.x.1)
                data-top=(top) data-bottom=(bottom) {
                @for &value in &up {
                    line.grid x1=(left) x2=(right) y1=(at(self.y(value))) y2=(at(self.y(value))) {}
                    text x=(left - 6.0) y=(at(self.y(value) + 4.0)) text-anchor="end" { (short(value, apart(&up))) }
                }
                @for &value in &across {
                    text x=(at(self.x(value))) y=(bottom + 14.0) text-anchor="middle" { (short(value, apart(&across))) }
                }
                (inside)
                line.axis x1=(left) x2=(right) y1=(bottom) y2=(bottom) {}
                line.axis x1=(left) x2=(left) y1=(top) y2=(bottom) {}
                text x=(right) y=(self.height - 4.0) text-anchor="end" { (labels.0) }
                text x=(left) y=(top - 8.0) { (labels.1) }
            }
        }
    }

    /// A line through points in order of x; with more points than pixels, each pixel keeps its lowest and highest
    /// value. NaN breaks the line.
    pub(super) fn line(&self, points: &[(f64, f64)], class: &str) -> Markup {
        let places = (self.width - LEFT - RIGHT).max(1.0);
        let mut path = String::new();
        let mut pen_down = false;
        for (x, y) in thinned(points, places, self.x) {
            if !y.is_finite() || !x.is_finite() {
                pen_down = false;
                continue;
            }
            path.push_str(&format!("{}{} {}", if pen_down { "L" } else { "M" }, at(self.x(x)), at(self.y(y))));
            pen_down = true;
        }
        html! { path class=(format!("line {class}")) d=(path) {} }
    }

    /// A bar from the bottom between two values of x.
    pub(super) fn bar(&self, (from, to): (f64, f64), height: f64, class: &str) -> Markup {
        let (left, right, top, bottom) = (self.x(from), self.x(to), self.y(height), self.y(self.y.0));
        html! {
            rect class=(class) x=(at(left)) y=(at(top)) width=(at((right - left - 0.6).max(0.4)))
                height=(at((bottom - top).max(0.0))) {}
        }
    }

    /// A range of x over the whole height.
    pub(super) fn stretch(&self, (from, to): (f64, f64), class: &str) -> Markup {
        let (left, right) = (self.x(from), self.x(to));
        html! {
            rect class=(class) x=(at(left)) y=(TOP) width=(at((right - left).max(0.6))) height=(self.height - BOTTOM - TOP) {}
        }
    }

    /// A level line.
    pub(super) fn level(&self, value: f64, class: &str) -> Markup {
        html! { line class=(class) x1=(LEFT) x2=(self.width - RIGHT) y1=(at(self.y(value))) y2=(at(self.y(value))) {} }
    }
}

/// The range of some values with a margin on both sides, so that a line does not run along the edge.
pub(super) fn roomy(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let (lo, hi) = range(values);
    let room = (hi - lo) * 0.04;
    (lo - room, hi + room)
}

/// The lowest and highest of some values, without NaN; 0 to 1 of none.
pub(super) fn range(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let finite = values.into_iter().filter(|value| value.is_finite());
    let (lo, hi) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), value| (lo.min(value), hi.max(value)));
    if lo > hi { (0.0, 1.0) } else { (lo, hi) }
}

fn widened((lo, hi): (f64, f64)) -> (f64, f64) {
    if hi - lo > f64::EPSILON * lo.abs().max(1.0) {
        return (lo, hi);
    }
    // Half a unit is less than the precision of a large number, such as a time in nanoseconds.
    let room = 0.5_f64.max(lo.abs() * 1e-3);
    (lo - room, lo + room)
}

/// At most about `most` round numbers between two.
fn ticks(lo: f64, hi: f64, most: u32) -> Vec<f64> {
    let rough = (hi - lo) / f64::from(most.max(1));
    let power = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|round| round * power).find(|&step| step >= rough * 0.999);
    let Some(step) = step.filter(|step| step.is_normal() && *step > 0.0) else { return vec![lo] };
    let first = (lo / step).ceil();
    (0..=2 * most).map(|n| (first + f64::from(n)) * step).take_while(|&value| value <= hi + step * 1e-9).collect()
}

fn thinned(points: &[(f64, f64)], places: f64, (from, to): (f64, f64)) -> Vec<(f64, f64)> {
    #[expect(clippy::cast_precision_loss, reason = "a count of points")]
    let few = points.len() as f64 <= 2.0 * places;
    if few {
        return points.to_vec();
    }
    let place = |x: f64| ((x - from) / (to - from) * places).floor();
    points
        .chunk_by(|a, b| place(a.0) == place(b.0))
        .flat_map(|near| {
            let pick = |better: fn(f64, f64) -> bool| {
                near.iter().copied().reduce(|best, next| if better(next.1, best.1) { next } else { best })
            };
            let mut ends: Vec<_> = [pick(|a, b| a < b), pick(|a, b| a > b)].into_iter().flatten().collect();
            ends.sort_by(|a, b| a.0.total_cmp(&b.0));
            ends
        })
        .collect()
}

fn at(place: f64) -> String {
    format!("{place:.1}")
}

/// The distance of neighbouring marks; of a single one, a thousandth of it.
fn apart(ticks: &[f64]) -> f64 {
    match ticks {
        [first, second, ..] => second - first,
        [only] => only.abs() * 1e-3,
        [] => 0.0,
    }
}

/// A number beside an axis whose marks are `step` apart, with the digits by which neighbours differ.
fn short(value: f64, step: f64) -> String {
    let size = value.abs();
    if size <= step * 1e-6 {
        return "0".to_owned();
    }
    let (first, last) = (power(size), power(step).min(power(size)));
    let digits = usize::try_from(first - last).unwrap_or(0);
    if !(1e-3..1e5).contains(&size) && digits <= 3 {
        let text = format!("{value:.digits$e}");
        return text
            .split_once('e')
            .map_or_else(String::new, |(mantissa, exponent)| format!("{}e{exponent}", trimmed(mantissa)));
    }
    trimmed(&format!("{value:.*}", usize::try_from(-last).unwrap_or(0))).to_owned()
}

/// Without zeros at the end of its decimals.
fn trimmed(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}

/// The power of ten of a number's first digit.
#[expect(clippy::cast_possible_truncation, reason = "a float's power of ten has three digits")]
fn power(number: f64) -> i32 {
    (number.log10() + 1e-9).floor() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        assert_eq!(ticks(0.0, 1.0, 4), [0.0, 0.5, 1.0]);
        assert_eq!(ticks(0.0, 200.0, 8).len(), 5);
        for (lo, hi) in [(-3.7, 12.1), (1e-9, 5e-9), (0.0, 1e12), (-0.5, 0.5)] {
            let ticks = ticks(lo, hi, 6);
            assert!((2..=12).contains(&ticks.len()), "{ticks:?}");
            assert!(ticks.iter().all(|&tick| tick >= lo && tick <= hi * 1.0001), "{ticks:?}");
        }
        let short = |value| short(value, apart(&[value]));
        assert_eq!([0.0, 0.25, 1500.0, 2e7].map(short), ["0", "0.25", "1500", "2e7"]);
    }

    #[test]
    fn neighbouring_marks_of_an_axis_have_different_numbers() {
        let marks = |lo, hi, most| {
            let ticks = ticks(lo, hi, most);
            ticks.iter().map(|&tick| short(tick, apart(&ticks))).collect::<Vec<_>>()
        };
        assert_eq!(marks(0.0, 200_000.0, 4), ["0", "50000", "1e5", "1.5e5", "2e5"]);
        assert_eq!(marks(0.0, 2e-4, 4), ["0", "5e-5", "1e-4", "1.5e-4", "2e-4"]);
        assert_eq!(marks(1000.0, 1000.001, 2), ["1000", "1000.0005", "1000.001"]);
        assert_eq!(marks(-1.0, 1.0, 4), ["-1", "-0.5", "0", "0.5", "1"]);
        assert_eq!(marks(999_999.5, 1_000_000.5, 2), ["999999.5", "1000000", "1000000.5"]);
        assert_eq!(marks(3.0, 3.0, 4), ["3"]);
    }

    #[test]
    fn a_constant_larger_than_its_precision_is_drawn() {
        let stamp = f64::from(1.7e18_f32);
        let frame = Frame::new((600.0, 200.0), (0.0, 1.0), roomy([stamp, stamp]));
        let drawn = frame.draw("t", ("s", "ns"), &frame.line(&[(0.0, stamp), (1.0, stamp)], "c1")).into_string();
        assert!(!drawn.contains("NaN") && !drawn.contains("inf"), "{drawn}");
    }

    #[test]
    fn a_line_is_thinned_and_keeps_its_extremes() {
        let points: Vec<(f64, f64)> =
            (0..100_000).map(|n| (f64::from(n), if n == 54_321 { 9.0 } else { f64::from(n % 2) })).collect();
        let thin = thinned(&points, 500.0, (0.0, 100_000.0));
        assert!(thin.len() <= 1002 && thin.contains(&(54_321.0, 9.0)));
    }

    #[test]
    fn nan_breaks_a_line_and_an_empty_range_is_drawn() {
        let frame = Frame::new((600.0, 200.0), range([2.0, f64::NAN]), range([]));
        let line = frame.line(&[(2.0, 0.5), (2.0, f64::NAN), (2.0, 1.0)], "c1").into_string();
        assert_eq!(line.matches('M').count(), 2);
        assert!(!frame.draw("t", ("s", "q"), &html! { (line) }).into_string().contains("NaN"));
    }
}
