//! Plots as SVG: light ground, axes with their units, intervals as whiskers.
//!
//! Draws numbers and labels; must not know experiments or servers.

use plotters::coord::Shift;
use plotters::coord::ranged1d::{IntoSegmentedCoord as _, SegmentValue};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::failure::{Failure, Result};

type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;

const SIZE: (u32, u32) = (720, 320);
const GOOD: RGBColor = RGBColor(42, 127, 98);
const BAD: RGBColor = RGBColor(196, 69, 54);
const BAR: RGBColor = RGBColor(86, 120, 166);
const LINES: [RGBColor; 6] = [GOOD, BAD, BAR, RGBColor(190, 140, 40), RGBColor(120, 80, 150), RGBColor(90, 90, 90)];
const TITLE: (&str, u32) = ("sans-serif", 17);
/// Most characters of a title, for which there is room.
const LONGEST_TITLE: usize = 80;

/// A value with its 95 % interval, if it has one.
#[derive(Clone, Debug)]
pub(crate) struct Bar {
    pub(crate) label: String,
    pub(crate) value: f64,
    pub(crate) interval: Option<(f64, f64)>,
}

/// A named line through points (x, y, interval of y).
#[derive(Clone, Debug)]
pub(crate) struct Line {
    pub(crate) name: String,
    pub(crate) points: Vec<(f64, f64, (f64, f64))>,
}

/// An axis with its range.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axis<'a> {
    pub(crate) name: &'a str,
    pub(crate) low: f64,
    pub(crate) high: f64,
}

/// Imperfect segments by q: for each bin over [0, 1] the good ones and, on top of them, the bad ones; and the outline of
/// the experts' bins, scaled to the same number of segments. The title names what they are of; empty: all that there is.
pub(crate) fn spread(of: &str, bins: &[[u32; 2]], experts: &[u64]) -> Result<String> {
    draw(SIZE, |canvas| {
        let of = shortened(of, LONGEST_TITLE);
        let below = if of.is_empty() { None } else { Some(canvas.titled(&of, TITLE).map_err(failed)?) };
        let canvas = below.as_ref().unwrap_or(canvas);
        let segments: u32 = bins.iter().map(|[good, bad]| good + bad).sum();
        let experts = outline(experts, f64::from(segments));
        let highest = experts.iter().map(|(_, height)| *height).fold(0.0, f64::max);
        let most = bins.iter().map(|[good, bad]| good + bad).max().unwrap_or(0).max(1);
        let top = f64::from(most).max(highest);
        let mut chart = ChartBuilder::on(canvas)
            .caption("Imperfect segments by q: good (green), bad (red); experts (line)", TITLE)
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(0.0..1.0, 0.0..top * 1.05)
            .map_err(failed)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .light_line_style(TRANSPARENT)
            .x_desc("q")
            .y_desc("segments")
            .y_label_formatter(&|count| tick(*count, top))
            .draw()
            .map_err(failed)?;
        let width = 1.0 / f64::from(u32::try_from(bins.len()).unwrap_or(u32::MAX).max(1));
        let parts = (0_u32..).zip(bins).flat_map(|(bin, &[good, bad])| {
            let (left, right) = (f64::from(bin) * width, f64::from(bin + 1) * width - 0.004);
            let (low, high) = (f64::from(good), f64::from(good + bad));
            [
                Rectangle::new([(left, 0.0), (right, low)], GOOD.filled()),
                Rectangle::new([(left, low), (right, high)], BAD.filled()),
            ]
        });
        chart.draw_series(parts).map_err(failed)?;
        chart.draw_series(LineSeries::new(experts, BLACK.stroke_width(2))).map_err(failed)?;
        Ok(())
    })
}

/// A text of at most this many characters.
fn shortened(text: &str, longest: usize) -> String {
    if text.chars().count() <= longest {
        return text.to_owned();
    }
    text.chars().take(longest.saturating_sub(1)).chain(['…']).collect()
}

/// The outline of bars of these counts, scaled to a number of segments; nothing without counts.
#[expect(clippy::cast_precision_loss, reason = "counts of segments, for a picture")]
fn outline(counts: &[u64], segments: f64) -> Vec<(f64, f64)> {
    let all = counts.iter().sum::<u64>() as f64;
    if all == 0.0 {
        return Vec::new();
    }
    let width = 1.0 / counts.len() as f64;
    let bar = |(bin, count): (u32, &u64)| {
        let (left, height) = (f64::from(bin) * width, *count as f64 * segments / all);
        [(left, height), (left + width, height)]
    };
    (0_u32..).zip(counts).flat_map(bar).collect()
}

/// One bar for each label, with whiskers.
pub(crate) fn bars(title: &str, axis: Axis<'_>, values: &[Bar]) -> Result<String> {
    draw(SIZE, |canvas| panel(canvas, title, axis, values))
}

/// Bars above bars with the same labels: a measure, and beneath it how much data it comes from.
pub(crate) fn two_panels(title: &str, above: (Axis<'_>, &[Bar]), below: (Axis<'_>, &[Bar])) -> Result<String> {
    draw((SIZE.0, SIZE.1 + 220), |canvas| {
        let (top, bottom) = canvas.split_vertically(SIZE.1);
        panel(&top, title, above.0, above.1)?;
        panel(&bottom, "", below.0, below.1)
    })
}

fn panel(canvas: &Canvas<'_>, title: &str, axis: Axis<'_>, values: &[Bar]) -> Result<()> {
    let Some(last) = values.len().checked_sub(1) else {
        return Ok(());
    };
    let mut chart = ChartBuilder::on(canvas)
        .caption(title, TITLE)
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(70)
        .build_cartesian_2d((0..last).into_segmented(), axis.low..axis.high)
        .map_err(failed)?;
    let name = |position: &SegmentValue<usize>| match position {
        SegmentValue::Exact(index) | SegmentValue::CenterOf(index) => {
            values.get(*index).map(|bar| bar.label.clone()).unwrap_or_default()
        }
        SegmentValue::Last => String::new(),
    };
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(TRANSPARENT)
        .x_labels(values.len())
        .x_label_formatter(&name)
        .y_desc(axis.name)
        .y_label_formatter(&|value| tick(*value, axis.high))
        .draw()
        .map_err(failed)?;
    let columns = values.iter().enumerate().map(|(index, bar)| (index, bar.value));
    chart
        .draw_series(Histogram::vertical(&chart).style(BAR.filled()).margin(14).baseline(axis.low).data(columns))
        .map_err(failed)?;
    let whiskers = values.iter().enumerate().filter_map(|(index, bar)| {
        let (low, high) = bar.interval?;
        Some(ErrorBar::new_vertical(SegmentValue::CenterOf(index), low, bar.value, high, BLACK.filled(), 8))
    });
    chart.draw_series(whiskers).map_err(failed)?;
    // Values without an interval are counts; bars of small counts would look empty.
    let counts = values.iter().enumerate().filter(|(_, bar)| bar.interval.is_none()).map(|(index, bar)| {
        let style = ("sans-serif", 12).into_font().color(&BLACK).pos(Pos::new(HPos::Center, VPos::Bottom));
        Text::new(format!("{:.0}", bar.value), (SegmentValue::CenterOf(index), bar.value), style)
    });
    chart.draw_series(counts).map_err(failed)?;
    Ok(())
}

// Whole numbers where that is exact enough.
fn tick(value: f64, high: f64) -> String {
    if high >= 10.0 { format!("{value:.0}") } else { format!("{value:.1}") }
}

/// Lines with whiskers and a legend.
pub(crate) fn lines(title: &str, x: Axis<'_>, y: Axis<'_>, series: &[Line]) -> Result<String> {
    draw(SIZE, |canvas| {
        let mut chart = ChartBuilder::on(canvas)
            .caption(title, TITLE)
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(70)
            .build_cartesian_2d(x.low..x.high, y.low..y.high)
            .map_err(failed)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .x_desc(x.name)
            .y_desc(y.name)
            .x_label_formatter(&|value| tick(*value, x.high))
            .y_label_formatter(&|value| tick(*value, y.high))
            .draw()
            .map_err(failed)?;
        for (line, color) in series.iter().zip(LINES.into_iter().cycle()) {
            let path = line.points.iter().map(|(x, y, _)| (*x, *y));
            chart
                .draw_series(LineSeries::new(path, color.stroke_width(2)))
                .map_err(failed)?
                .label(&line.name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], color.stroke_width(2)));
            let whiskers = line
                .points
                .iter()
                .map(|&(x, y, (low, high))| ErrorBar::new_vertical(x, low, y, high, color.filled(), 6));
            chart.draw_series(whiskers).map_err(failed)?;
        }
        let legend = chart.configure_series_labels().background_style(WHITE).border_style(BLACK.mix(0.3)).draw();
        legend.map_err(failed)
    })
}

fn draw(size: (u32, u32), paint: impl FnOnce(&Canvas<'_>) -> Result<()>) -> Result<String> {
    let mut svg = String::new();
    {
        let canvas = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        canvas.fill(&WHITE).map_err(failed)?;
        paint(&canvas)?;
        canvas.present().map_err(failed)?;
    }
    Ok(svg)
}

fn failed(problem: impl std::fmt::Display) -> Failure {
    Failure::message(format!("drawing a figure: {problem}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bar(label: &str, value: f64) -> Bar {
        Bar { label: label.into(), value, interval: Some((value - 5.0, value + 5.0)) }
    }

    const PERCENT: Axis<'static> = Axis { name: "success, %", low: 0.0, high: 100.0 };

    #[test]
    fn every_bar_has_its_label_once() {
        let values = [bar("BC", 20.0), bar("TF-BC", 40.0), bar("SSDF", 80.0)];
        let svg = bars("Methods", PERCENT, &values).unwrap();
        for label in ["BC", "TF-BC", "SSDF", "Methods", "success, %"] {
            assert_eq!(svg.matches(&format!("\n{label}\n")).count(), 1, "{label} in {svg}");
        }
        assert!(bars("One", PERCENT, &values[..1]).unwrap().contains("\nBC\n"));
        assert!(bars("None", PERCENT, &[]).unwrap().starts_with("<svg"));
    }

    #[test]
    fn two_panels_and_lines_are_drawn_with_their_axes() {
        let values = [bar("0", 20.0), bar("0.9", 80.0)];
        let counts = Axis { name: "kept segments", low: 0.0, high: 90.0 };
        let svg = two_panels("β", (PERCENT, &values), (counts, &values)).unwrap();
        assert!(svg.contains("\nsuccess, %\n") && svg.contains("\nkept segments\n"));
        let line = |name: &str| Line {
            name: name.into(),
            points: vec![(0.0, 40.0, (30.0, 50.0)), (50.0, 60.0, (50.0, 70.0))],
        };
        let x = Axis { name: "behaviour success, %", low: 0.0, high: 100.0 };
        let svg = lines("Quantity", x, PERCENT, &[line("1:1"), line("1:3")]).unwrap();
        assert!(svg.contains("\n1:1\n") && svg.contains("\n1:3\n") && svg.contains("\nbehaviour success, %\n"));
    }

    #[test]
    fn a_spread_of_zero_does_not_divide_by_zero() {
        assert!(spread("", &[], &[]).unwrap().starts_with("<svg"));
        let plain = spread("", &[[0, 0], [3, 1]], &[]).unwrap();
        assert!(plain.contains("rect") && !plain.contains("#000000\" stroke-width=\"2\""), "{plain}");
        assert!(spread("", &[[0, 0], [3, 1]], &[1, 3]).unwrap().contains("#000000\" stroke-width=\"2\""));
        assert_eq!(outline(&[1, 3], 8.0), [(0.0, 2.0), (0.5, 2.0), (0.5, 6.0), (1.0, 6.0)]);
    }

    #[test]
    fn a_spread_names_what_it_is_of_in_a_line_that_has_room() {
        let svg = spread("a < b, seed 0", &[[3, 1]], &[]).unwrap();
        assert_eq!(svg.matches("\na &lt; b, seed 0\n").count(), 1, "{svg}");
        assert!(svg.contains("\nImperfect segments by q"), "{svg}");
        assert_eq!((shortened("abcd", 4), shortened("abcde", 4)), ("abcd".to_owned(), "abc…".to_owned()));
    }
}
