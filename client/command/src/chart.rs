//! Charts in a terminal: a curve over steps, and bars.

const EIGHTHS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
const FULL: usize = 8;
// The axis: a label of five characters, a space and a stroke.
const MARGIN: usize = 7;
// Short episodes are drawn wider, but not so wide that steps become indistinct.
const WIDEST_STEP: usize = 3;

/// Values of [0, 1] over steps as filled columns, `rows` high and at most `width` wide, with a line at β.
/// More steps than columns are averaged; values that are no numbers stay blank.
pub(crate) fn curve(values: &[f32], width: usize, rows: usize, beta: Option<f64>) -> String {
    let columns = columns(values, width.saturating_sub(MARGIN).max(1));
    let rows = rows.max(1);
    let beta_row = beta.map(|beta| rows - 1 - floor(beta * to_f64(rows)).min(rows - 1));
    let mut lines = Vec::with_capacity(rows + 2);
    for row in 0..rows {
        let label = match beta {
            Some(beta) if beta_row == Some(row) => format!("β{beta:.2}"),
            Some(_) | None if row == 0 => " 1.00".into(),
            Some(_) | None => "     ".into(),
        };
        let floor_eighths = (rows - 1 - row) * FULL;
        let cells = columns.iter().map(|value| {
            let level = value.map_or(0, |value| floor(value * to_f64(rows * FULL) + 0.5));
            match level.saturating_sub(floor_eighths).min(FULL) {
                0 if beta_row == Some(row) => '╌',
                eighths => EIGHTHS[eighths],
            }
        });
        lines.push(format!("{label} │{}", cells.collect::<String>()).trim_end().to_owned());
    }
    lines.push(format!(" 0.00 └{}", "─".repeat(columns.len())));
    let last = if values.len() > 1 { (values.len() - 1).to_string() } else { String::new() };
    let gap = columns.len().saturating_sub(1 + last.len());
    lines.push(format!("{}0{}{last}", " ".repeat(MARGIN), " ".repeat(gap)).trim_end().to_owned());
    lines.join("\n")
}

// One value for each column: steps repeated or averaged until they fit.
fn columns(values: &[f32], width: usize) -> Vec<Option<f64>> {
    let number = |value: &f32| value.is_finite().then(|| f64::from(*value).clamp(0.0, 1.0));
    if values.len() <= width {
        let repeat = (width / values.len().max(1)).clamp(1, WIDEST_STEP);
        return values.iter().flat_map(|value| std::iter::repeat_n(number(value), repeat)).collect();
    }
    let bucket = |column: usize| {
        let part = &values[column * values.len() / width..(column + 1) * values.len() / width];
        let numbers: Vec<f64> = part.iter().filter_map(number).collect();
        (!numbers.is_empty()).then(|| numbers.iter().sum::<f64>() / to_f64(numbers.len()))
    };
    (0..width).map(bucket).collect()
}

/// Counts as a line of columns, `width` at most, the highest of which is full. More counts than columns are averaged; any
/// above 0 shows.
pub(crate) fn columns_of(counts: &[u64], width: usize) -> String {
    let width = width.clamp(1, counts.len().max(1));
    let mean = |column: usize| {
        let part = &counts[column * counts.len() / width..(column + 1) * counts.len() / width];
        #[expect(clippy::cast_precision_loss, reason = "for a picture")]
        let sum = part.iter().sum::<u64>() as f64;
        sum / to_f64(part.len().max(1))
    };
    let means: Vec<f64> = (0..width).map(mean).collect();
    let most = means.iter().copied().fold(0.0, f64::max);
    let eighths = |mean: f64| if mean > 0.0 { floor(to_f64(FULL) * mean / most).clamp(1, FULL) } else { 0 };
    means.into_iter().map(|mean| EIGHTHS[eighths(mean)]).collect::<String>().trim_end().to_owned()
}

/// A horizontal bar of `part` out of `whole`, at most `width` wide. Any part above 0 shows.
pub(crate) fn bar(part: u64, whole: u64, width: usize) -> String {
    const PARTS: [char; 8] = ['▏', '▎', '▍', '▌', '▋', '▊', '▉', '█'];
    if part == 0 || whole == 0 {
        return String::new();
    }
    #[expect(clippy::cast_precision_loss, reason = "drawn in eighths of a character")]
    let share = part as f64 / whole as f64;
    let eighths = floor(share * to_f64(width * FULL) + 0.5).clamp(1, width * FULL);
    let mut drawn = "█".repeat(eighths / FULL);
    if !eighths.is_multiple_of(FULL) {
        drawn.push(PARTS[eighths % FULL - 1]);
    }
    drawn
}

#[expect(clippy::cast_precision_loss, reason = "counts of columns and steps are far below 2^52")]
fn to_f64(count: usize) -> f64 {
    count as f64
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the cast saturates, which is what is meant below 0"
)]
fn floor(value: f64) -> usize {
    value.floor() as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn merged_columns_are_averages_so_that_even_counts_are_even() {
        for (counts, columns) in [(21, 20), (50, 20), (100, 20), (20, 20), (3, 3), (1, 1)] {
            assert_eq!(columns_of(&vec![7; counts], 20), "█".repeat(columns), "{counts}");
        }
        assert_eq!(columns_of(&[0, 1, 1000, 500], 20), " ▁█▄");
        assert_eq!((columns_of(&[], 20), columns_of(&[0, 0], 20)), (String::new(), String::new()));
    }

    #[test]
    fn a_curve_is_drawn() {
        let values: Vec<f32> = vec![0.0, 0.125, 0.25, 0.5, 0.75, 0.9, 1.0, f32::NAN, 0.3];
        let drawn = curve(&values, 7 + 18, 4, Some(0.6));
        let lines: Vec<&str> = drawn.lines().collect();
        assert_eq!(
            lines,
            [
                " 1.00 │          ▅▅██",
                "β0.60 │╌╌╌╌╌╌╌╌██████╌╌╌╌",
                "      │      ████████  ▂▂",
                "      │  ▄▄██████████  ██",
                " 0.00 └──────────────────",
                "       0                8",
            ]
        );
    }

    #[test]
    fn long_episodes_are_averaged_to_the_width() {
        let values: Vec<f32> = (0..100).map(|step| if step < 50 { 1.0 } else { 0.0 }).collect();
        let drawn = curve(&values, 7 + 10, 1, None);
        assert_eq!(drawn, " 1.00 │█████\n 0.00 └──────────\n       0       99");
    }

    #[test]
    fn zero_steps_or_zero_width_do_not_panic() {
        assert_eq!(curve(&[], 3, 0, Some(2.0)), "β2.00 │\n 0.00 └\n       0");
    }

    #[test]
    fn bars_are_in_proportion_and_never_hide_what_is_there() {
        assert_eq!(bar(10, 10, 4), "████");
        assert_eq!(bar(5, 16, 4), "█▎");
        assert_eq!(bar(1, 10_000, 4), "▏");
        assert_eq!(bar(0, 10, 4), "");
        assert_eq!(bar(0, 0, 4), "");
    }
}
