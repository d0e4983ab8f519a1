//! Plots as SVG: light ground, axes with their units, intervals as whiskers.
//!
//! Draws numbers and labels; must not know experiments or servers.

use plotters::coord::Shift;
use plotters::coord::ranged1d::{IntoSegmentedCoord as _, SegmentValue};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::failure::{Failure, Result};

mod distribution;

pub(crate) use distribution::spread;

type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;

const SIZE: (u32, u32) = (720, 320);
const GOOD: RGBColor = RGBColor(42, 127, 98);
const BAD: RGBColor = RGBColor(196, 69, 54);
const BAR: RGBColor = RGBColor(86, 120, 166);
const LINES: [RGBColor; 6] = [GOOD, BAD, BAR, RGBColor(190, 140, 40), RGBColor(120, 80, 150), RGBColor(90, 90, 90)];
const TITLE: (&str, u32) = ("sans-serif", 17);

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
}
