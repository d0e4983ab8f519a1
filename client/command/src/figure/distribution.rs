//! The distribution of q: imperfect segments as bars, those of experts and of cohorts as lines.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{BAD, Canvas, GOOD, SIZE, TITLE, draw, failed, tick};
use crate::failure::Result;
use gleaner_core::score::legible_height;

/// Cohorts with a line of their own at most.
const COHORTS: usize = 8;
/// Of the cohorts' lines, without the green and the red of the bars; the last is that of the other cohorts together.
const COLORS: [RGBColor; COHORTS + 1] = [
    RGBColor(34, 100, 197),
    RGBColor(230, 120, 0),
    RGBColor(139, 63, 168),
    RGBColor(166, 131, 0),
    RGBColor(0, 180, 205),
    RGBColor(214, 51, 138),
    RGBColor(107, 74, 43),
    RGBColor(12, 28, 92),
    RGBColor(120, 120, 120),
];
/// Names in the legend: of the experts, of the cohorts without a line of their own, and of episodes without a cohort.
const EXPERTS: &str = "(experts)";
const OTHERS: &str = "(others)";
const NAMELESS: &str = "(none)";
/// Most characters of a title and of a name in the legend, for which there is room.
const LONGEST_TITLE: usize = 80;
const LONGEST_NAME: usize = 28;
/// Width of the legend, the height of its first line and of each line, and the length of a line's sample.
const LEGEND: u32 = 190;
const LEGEND_TOP: i32 = 44;
const LEGEND_LINE: i32 = 18;
const SAMPLE: i32 = 16;
/// The height of the plot, in multiples of its highest bar.
const ABOVE: f64 = 1.05;

/// The line of a cohort.
struct CohortLine {
    name: String,
    color: RGBColor,
    points: Vec<(f64, f64)>,
}

/// Imperfect segments by q: for each bin over [0, 1] the good ones and, on top of them, the bad ones; and the outlines of
/// the bins of experts and of each cohort, scaled to the same number of segments. Bars that would hide the others are cut off. The title names what they are of; empty:
/// all that there is.
pub(crate) fn spread(
    of: &str,
    bins: &[[u32; 2]],
    experts: &[u64],
    cohorts: &BTreeMap<String, Vec<u64>>,
) -> Result<String> {
    let segments = f64::from(bins.iter().map(|[good, bad]| good + bad).sum::<u32>());
    let experts = outline(experts, segments);
    let cohorts = cohort_lines(cohorts, segments);
    let width = if cohorts.is_empty() { SIZE.0 } else { SIZE.0 + LEGEND };
    draw((width, SIZE.1), |canvas| {
        let sides = (!cohorts.is_empty()).then(|| canvas.split_horizontally(SIZE.0));
        if let Some((_, beside)) = &sides {
            let of_experts = (!experts.is_empty()).then_some((EXPERTS, BLACK));
            let of_cohorts = cohorts.iter().map(|line| (line.name.as_str(), line.color));
            legend(beside, of_experts.into_iter().chain(of_cohorts))?;
        }
        let canvas = sides.as_ref().map_or(canvas, |(plot, _)| plot);
        let of = shortened(of, LONGEST_TITLE);
        let below = if of.is_empty() { None } else { Some(canvas.titled(&of, TITLE).map_err(failed)?) };
        let canvas = below.as_ref().unwrap_or(canvas);
        let highest = |points: &[(f64, f64)]| points.iter().map(|(_, height)| *height).fold(0.0, f64::max);
        let lines = cohorts.iter().map(|line| highest(&line.points)).fold(highest(&experts), f64::max);
        let heights: Vec<f64> = bins.iter().map(|[good, bad]| f64::from(good + bad)).collect();
        let most = heights.iter().copied().fold(1.0, f64::max).max(lines);
        let cut = legible_height(&heights).filter(|cut| *cut < most);
        let top = cut.unwrap_or(most);
        let within = |points: Vec<(f64, f64)>| points.into_iter().map(move |(q, height)| (q, height.min(top * ABOVE)));
        let named = match (cohorts.is_empty(), experts.is_empty()) {
            (true, _) => "experts (line)",
            (false, false) => "experts and cohorts (lines)",
            (false, true) => "cohorts (lines)",
        };
        let mut chart = ChartBuilder::on(canvas)
            .caption(format!("Imperfect segments by q: good (green), bad (red); {named}"), TITLE)
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(60)
            .build_cartesian_2d(0.0..1.0, 0.0..top * ABOVE)
            .map_err(failed)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .light_line_style(TRANSPARENT)
            .x_desc("q")
            .y_desc(cut.map_or_else(|| "segments".to_owned(), |cut| format!("segments, cut off above {cut:.0}")))
            .y_label_formatter(&|count| tick(*count, top))
            .draw()
            .map_err(failed)?;
        let width = 1.0 / f64::from(u32::try_from(bins.len()).unwrap_or(u32::MAX).max(1));
        // Thin lines are seen on pale bars only.
        let strength = if cohorts.is_empty() { 1.0 } else { 0.5 };
        let parts = (0_u32..).zip(bins).flat_map(|(bin, &[good, bad])| {
            let (left, right) = (f64::from(bin) * width, f64::from(bin + 1) * width - 0.004);
            let [low, high] = [good, good + bad].map(|height| f64::from(height).min(top * ABOVE));
            [
                Rectangle::new([(left, 0.0), (right, low)], GOOD.mix(strength).filled()),
                Rectangle::new([(left, low), (right, high)], BAD.mix(strength).filled()),
            ]
        });
        chart.draw_series(parts).map_err(failed)?;
        for CohortLine { points, color, .. } in cohorts {
            chart.draw_series(LineSeries::new(within(points), color.stroke_width(1))).map_err(failed)?;
        }
        chart.draw_series(LineSeries::new(within(experts), BLACK.stroke_width(2))).map_err(failed)?;
        Ok(())
    })
}

/// The line of each cohort by name, and of those beyond the largest together. A single cohort has none: it is that of the
/// bars.
fn cohort_lines(cohorts: &BTreeMap<String, Vec<u64>>, segments: f64) -> Vec<CohortLine> {
    let counted = cohorts.iter().map(|(cohort, counts)| (cohort.as_str(), counts.as_slice()));
    let mut largest: Vec<(&str, &[u64])> =
        counted.filter(|(_, counts)| counts.iter().any(|count| *count > 0)).collect();
    if largest.len() < 2 {
        return Vec::new();
    }
    largest.sort_by_key(|(_, counts)| Reverse(counts.iter().sum::<u64>()));
    let others = largest.split_off(largest.len().min(COHORTS));
    largest.sort_by_key(|(cohort, _)| *cohort);
    let named = |cohort: &str| if cohort.is_empty() { NAMELESS.to_owned() } else { shortened(cohort, LONGEST_NAME) };
    let mut lines: Vec<(String, Vec<(f64, f64)>)> =
        largest.into_iter().map(|(cohort, counts)| (named(cohort), outline(counts, segments))).collect();
    if !others.is_empty() {
        lines.push((OTHERS.to_owned(), outline(&joined(&others), segments)));
    }
    lines.into_iter().zip(COLORS).map(|((name, points), color)| CohortLine { name, color, points }).collect()
}

/// The counts of several cohorts together.
fn joined(cohorts: &[(&str, &[u64])]) -> Vec<u64> {
    let mut all: Vec<u64> = Vec::new();
    for (_, counts) in cohorts {
        all.resize(all.len().max(counts.len()), 0);
        for (sum, count) in all.iter_mut().zip(counts.iter()) {
            *sum += *count;
        }
    }
    all
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

/// A text of at most this many characters.
fn shortened(text: &str, longest: usize) -> String {
    if text.chars().count() <= longest {
        return text.to_owned();
    }
    text.chars().take(longest.saturating_sub(1)).chain(['…']).collect()
}

/// A sample and the name of each line, one below the other.
fn legend<'n>(area: &Canvas<'_>, lines: impl Iterator<Item = (&'n str, RGBColor)>) -> Result<()> {
    let style = ("sans-serif", 12).into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
    for (place, (name, color)) in (0_i32..).zip(lines) {
        let y = LEGEND_TOP + place * LEGEND_LINE;
        area.draw(&PathElement::new([(0, y), (SAMPLE, y)], color.stroke_width(2))).map_err(failed)?;
        area.draw_text(name, &style, (SAMPLE + 8, y)).map_err(failed)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cohorts(counts: &[(&str, [u64; 2])]) -> BTreeMap<String, Vec<u64>> {
        counts.iter().map(|(cohort, counts)| ((*cohort).to_owned(), counts.to_vec())).collect()
    }

    /// How many lines of this width there are in each colour of a cohort.
    fn drawn(svg: &str, width: u32) -> [usize; COHORTS + 1] {
        COLORS.map(|RGBColor(red, green, blue)| {
            svg.matches(&format!("stroke=\"#{red:02X}{green:02X}{blue:02X}\" stroke-width=\"{width}\"")).count()
        })
    }

    #[test]
    fn a_spread_of_zero_does_not_divide_by_zero() {
        let none = cohorts(&[]);
        assert!(spread("", &[], &[], &none).unwrap().starts_with("<svg"));
        let zero = cohorts(&[("a", [0, 0]), ("b", [0, 0])]);
        assert!(spread("", &[], &[], &zero).unwrap().starts_with("<svg"));
        let plain = spread("", &[[0, 0], [3, 1]], &[], &none).unwrap();
        assert!(plain.contains("rect") && !plain.contains("#000000\" stroke-width=\"2\""), "{plain}");
        assert!(spread("", &[[0, 0], [3, 1]], &[1, 3], &none).unwrap().contains("#000000\" stroke-width=\"2\""));
        assert_eq!(outline(&[1, 3], 8.0), [(0.0, 2.0), (0.5, 2.0), (0.5, 6.0), (1.0, 6.0)]);
    }

    #[test]
    fn a_spread_names_what_it_is_of_in_a_line_that_has_room() {
        let svg = spread("a < b, seed 0", &[[3, 1]], &[], &cohorts(&[])).unwrap();
        assert_eq!(svg.matches("\na &lt; b, seed 0\n").count(), 1, "{svg}");
        assert!(svg.contains("\nImperfect segments by q"), "{svg}");
        assert_eq!((shortened("abcd", 4), shortened("abcde", 4)), ("abcd".to_owned(), "abc…".to_owned()));
    }

    #[test]
    fn every_cohort_is_a_thin_line_with_its_name_in_the_legend() {
        let three = cohorts(&[("", [1, 0]), ("a < b", [1, 1]), ("late", [0, 5])]);
        let svg = spread("", &[[2, 0], [4, 2]], &[1, 3], &three).unwrap();
        for name in ["(none)", "a &lt; b", "late", "(experts)"] {
            assert_eq!(svg.matches(&format!("\n{name}\n")).count(), 1, "{name} in {svg}");
        }
        assert_eq!(drawn(&svg, 1), [1, 1, 1, 0, 0, 0, 0, 0, 0], "lines in {svg}");
        assert_eq!(drawn(&svg, 2), [1, 1, 1, 0, 0, 0, 0, 0, 0], "samples of the legend in {svg}");
        assert!(svg.contains("; experts and cohorts (lines)\n"), "{svg}");
        let lines = cohort_lines(&three, 8.0);
        assert_eq!(lines[1].points, [(0.0, 4.0), (0.5, 4.0), (0.5, 4.0), (1.0, 4.0)]);
        assert_eq!(lines[2].points, [(0.0, 0.0), (0.5, 0.0), (0.5, 8.0), (1.0, 8.0)]);
        let svg = spread("", &[[2, 0], [4, 2]], &[], &three).unwrap();
        assert!(!svg.contains("\n(experts)\n") && svg.contains("; cohorts (lines)\n"), "{svg}");
    }

    #[test]
    fn bars_that_would_hide_the_others_are_cut_off() {
        let bars = |first: u32| [vec![[first, 0]], vec![[2, 1]; 19]].concat();
        let even = spread("", &bars(20), &[1, 1], &cohorts(&[])).unwrap();
        assert!(even.contains("\nsegments\n"), "{even}");
        let cut = spread("", &bars(5000), &[1, 1], &cohorts(&[])).unwrap();
        assert!(cut.contains("\nsegments, cut off above 12\n"), "{cut}");
        // Nothing is drawn above the picture.
        assert!(!cut.contains(" y=\"-") && !cut.contains(",-"), "{cut}");
    }

    #[test]
    fn no_cohort_and_a_single_one_have_neither_line_nor_legend() {
        for few in [cohorts(&[]), cohorts(&[("late", [0, 4])]), cohorts(&[("late", [0, 4]), ("wrong", [0, 0])])] {
            let svg = spread("", &[[0, 0], [3, 1]], &[1, 3], &few).unwrap();
            assert_eq!(drawn(&svg, 1), [0; COHORTS + 1], "{svg}");
            assert!(!svg.contains("\n(experts)\n") && !svg.contains("\nlate\n"), "{svg}");
            assert!(svg.starts_with("<svg width=\"720\"") && svg.contains("; experts (line)\n"), "{svg}");
        }
    }

    #[test]
    fn cohorts_beyond_the_eight_largest_are_one_line() {
        let ten: BTreeMap<String, Vec<u64>> = (1..=10_u64).map(|size| (format!("c{size}"), vec![size, 1])).collect();
        let lines = cohort_lines(&ten, 10.0);
        let names: Vec<&str> = lines.iter().map(|line| line.name.as_str()).collect();
        assert_eq!(names, ["c10", "c3", "c4", "c5", "c6", "c7", "c8", "c9", "(others)"]);
        assert_eq!(lines[8].points, [(0.0, 6.0), (0.5, 6.0), (0.5, 4.0), (1.0, 4.0)], "of c1 and c2");
        let svg = spread("", &[[55, 0], [0, 10]], &[], &ten).unwrap();
        assert_eq!(drawn(&svg, 1), [1; COHORTS + 1], "{svg}");
        assert!(svg.contains("\n(others)\n") && !svg.contains("\nc1\n"), "{svg}");
    }

    #[test]
    fn long_names_of_cohorts_are_shortened() {
        let (long, short) = ("x".repeat(LONGEST_NAME + 1), "x".repeat(LONGEST_NAME - 1) + "…");
        let svg = spread("", &[[2, 2]], &[], &cohorts(&[(long.as_str(), [1, 1]), ("late", [1, 1])])).unwrap();
        assert_eq!(svg.matches(&format!("\n{short}\n")).count(), 1, "{svg}");
    }
}
