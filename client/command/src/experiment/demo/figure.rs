//! The report's picture of q along some episodes, as SVG.

use std::fmt::Write as _;

use crate::quality::MarkedEpisode;

const GOOD: &str = "#2a7f62";
const WRONG: &str = "#c44536";
const WIDTH: f64 = 640.0;
const EDGE: f64 = 30.0;

/// q along the first episode of each cohort, with a line where it went wrong.
pub(crate) fn curves(episodes: &[MarkedEpisode]) -> String {
    let mut shown: Vec<&MarkedEpisode> = Vec::new();
    for episode in episodes {
        if shown.iter().all(|other| other.scores.cohort != episode.scores.cohort) {
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
    let last = u32::try_from(episode.scores.q.len().saturating_sub(1)).unwrap_or(u32::MAX).max(1);
    let x = |step: u32| EDGE + f64::from(step) / f64::from(last) * (WIDTH - 2.0 * EDGE);
    let point = |(step, q): (u32, &f32)| format!("{:.1},{:.1}", x(step), floor - f64::from(*q) * room);
    let points: Vec<String> = (0..).zip(&episode.scores.q).map(point).collect();
    let _ = writeln!(body, r#"<polyline fill="none" stroke="{GOOD}" stroke-width="2" points="{}"/>"#, points.join(" "));
    let _ = writeln!(body, r##"<path d="M{EDGE} {floor}H{:.1}" stroke="#999"/>"##, WIDTH - EDGE);
    for step in [episode.mark.went_right, episode.mark.went_wrong].into_iter().flatten() {
        let at = x(step.min(last));
        let _ = writeln!(
            body,
            r#"<path d="M{at:.1} {floor}V{:.1}" stroke="{WRONG}" stroke-dasharray="4 3"/>"#,
            floor - room
        );
    }
    label(body, [EDGE, top + 16.0], &format!("{} ({})", episode.scores.cohort, episode.scores.episode_id));
}

fn label(body: &mut String, [x, y]: [f64; 2], text: &str) {
    // Names of cohorts are any text.
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
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
    use gleaner_core::{id::EpisodeId, selection::Candidate};

    use super::*;
    use crate::quality::Mark;

    #[test]
    fn each_cohort_has_one_curve_and_its_mark() {
        let episode = |cohort: &str, went_wrong: Option<u32>| MarkedEpisode {
            scores: Candidate {
                episode_id: EpisodeId::new(),
                cohort: cohort.into(),
                w: vec![0.0; 3],
                q: vec![1.0, 0.5, 0.0],
                places: Vec::new(),
            },
            success: went_wrong.is_none(),
            mark: Mark { went_right: None, went_wrong },
        };
        let drawn = curves(&[episode("freeze", Some(1)), episode("freeze", Some(2)), episode("noise", None)]);
        assert!(curves(&[episode("a<b&c", None)]).contains(">a&lt;b&amp;c ("));
        assert_eq!((drawn.matches("<polyline").count(), drawn.matches("dasharray").count()), (2, 1));
    }
}
