//! The report's pictures, as SVG: how q is spread over good and wrong steps, and q along some episodes.

use std::fmt::Write as _;

use super::quality::MarkedEpisode;

const GOOD: &str = "#2a7f62";
const WRONG: &str = "#c44536";
const BINS: usize = 20;
const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 220.0;
const EDGE: f64 = 30.0;

/// Steps by their q, good ones below and wrong ones on top.
pub(crate) fn histogram(episodes: &[MarkedEpisode]) -> String {
    let mut bins = [(0_u32, 0_u32); BINS];
    for (q, good) in episodes.iter().flat_map(MarkedEpisode::steps) {
        let (good_count, wrong_count) = &mut bins[bin(q)];
        *(if good { good_count } else { wrong_count }) += 1;
    }
    let most = bins.iter().map(|(good, wrong)| good + wrong).max().unwrap_or(0).max(1);
    let (bar, scale) = ((WIDTH - 2.0 * EDGE) / f64::from(20_u8), (HEIGHT - 2.0 * EDGE) / f64::from(most));
    let mut body = String::new();
    for (x, (good, wrong)) in (0_u32..).zip(bins) {
        let left = EDGE + f64::from(x) * bar;
        let (low, high) = (f64::from(good) * scale, f64::from(wrong) * scale);
        rectangle(&mut body, [left, HEIGHT - EDGE - low, bar - 1.0, low], GOOD);
        rectangle(&mut body, [left, HEIGHT - EDGE - low - high, bar - 1.0, high], WRONG);
    }
    label(&mut body, [EDGE, 18.0], "steps by q: good (green), wrong (red)");
    label(&mut body, [EDGE, HEIGHT - 10.0], "0");
    label(&mut body, [WIDTH - EDGE - 8.0, HEIGHT - 10.0], "1");
    frame(HEIGHT, &body)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "q is in [0, 1]; the cast saturates"
)]
fn bin(q: f64) -> usize {
    ((q * BINS as f64) as usize).min(BINS - 1)
}

/// q along the first episode of each kind, with a line where it went wrong.
pub(crate) fn curves(episodes: &[MarkedEpisode]) -> String {
    let mut shown: Vec<&MarkedEpisode> = Vec::new();
    for episode in episodes {
        if shown.iter().all(|other| other.kind != episode.kind) {
            shown.push(episode);
        }
    }
    let row_height = 90.0;
    let mut body = String::new();
    let mut top = 0.0;
    for episode in shown {
        curve(&mut body, episode, top, row_height);
        top += row_height;
    }
    frame(top, &body)
}

fn curve(body: &mut String, episode: &MarkedEpisode, top: f64, height: f64) {
    let (floor, room) = (top + height - 8.0, height - 30.0);
    let last = u32::try_from(episode.q.len().saturating_sub(1)).unwrap_or(u32::MAX).max(1);
    let x = |step: u32| EDGE + f64::from(step) / f64::from(last) * (WIDTH - 2.0 * EDGE);
    let point = |(step, q): (u32, &f32)| format!("{:.1},{:.1}", x(step), floor - f64::from(*q) * room);
    let points: Vec<String> = (0..).zip(&episode.q).map(point).collect();
    let _ = writeln!(body, r#"<polyline fill="none" stroke="{GOOD}" stroke-width="2" points="{}"/>"#, points.join(" "));
    let _ = writeln!(body, r##"<path d="M{EDGE} {floor}H{:.1}" stroke="#999"/>"##, WIDTH - EDGE);
    if let Some(wrong) = episode.went_wrong {
        let at = x(wrong.min(last));
        let _ = writeln!(
            body,
            r#"<path d="M{at:.1} {floor}V{:.1}" stroke="{WRONG}" stroke-dasharray="4 3"/>"#,
            floor - room
        );
    }
    label(body, [EDGE, top + 16.0], &format!("{} ({})", episode.kind.name(), episode.id));
}

fn rectangle(body: &mut String, [x, y, width, height]: [f64; 4], fill: &str) {
    let _ = writeln!(body, r#"<rect x="{x:.1}" y="{y:.1}" width="{width:.1}" height="{height:.1}" fill="{fill}"/>"#);
}

fn label(body: &mut String, [x, y]: [f64; 2], text: &str) {
    let _ = writeln!(body, r#"<text x="{x:.1}" y="{y:.1}">{text}</text>"#);
}

fn frame(height: f64, body: &str) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n{body}</svg>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_sim::AgentKind;

    #[test]
    fn each_kind_has_one_curve_and_its_mark() {
        let episode = |kind, went_wrong| MarkedEpisode { id: "ep".into(), kind, went_wrong, q: vec![1.0, 0.5, 0.0] };
        let drawn = curves(&[
            episode(AgentKind::Freeze, Some(1)),
            episode(AgentKind::Freeze, Some(2)),
            episode(AgentKind::Noise, None),
        ]);
        assert_eq!((drawn.matches("<polyline").count(), drawn.matches("dasharray").count()), (2, 1));
    }

    #[test]
    fn the_ends_of_q_fall_into_the_end_bins() {
        assert_eq!([bin(0.0), bin(0.05), bin(0.999), bin(1.0)], [0, 1, 19, 19]);
    }
}
