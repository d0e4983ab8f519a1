//! Frozen cameras: the same pixels, message after message, while the robot moves.

use std::ops::Range;

use crate::plan::{ImageStream, Plan};
use gleaner_core::{FindingCode, Report, Severity};

use super::FROZEN_STEPS;

/// The robot has moved when some value of its proprioception spans more than this (radians or metres). A smaller
/// movement may leave every pixel of a noise-free camera the same.
const MOVED: f32 = 0.05;

/// Reports the longest stretch of identical images of each camera. `shown` has for each stream (by its number in the
/// plan) and step the number of its picture, which is the same for identical pictures in sequence; 0 for a broken one.
pub(crate) fn frozen_cameras(plan: &Plan, shown: &[Vec<u32>], report: &mut Report) {
    for (at, stream) in plan.images.iter().enumerate() {
        let steps = plan.stamps.len();
        let (mut begin, mut worst) = (0, 0..0);
        for step in 1..=steps {
            if step < steps && shown[at][step] != 0 && shown[at][step] == shown[at][begin] {
                continue;
            }
            let stretch = begin..step;
            if stretch.len() > worst.len() && messages(stream, &stretch) >= FROZEN_STEPS && moves(plan, &stretch) {
                worst = stretch;
            }
            begin = step;
        }
        if worst.is_empty() {
            continue;
        }
        let detail = format!(
            "the image stays the same for {} steps while the robot moves; check the camera's driver, or ignore this if \
             the camera's view is static",
            worst.len()
        );
        let first = Some(worst.start as u64);
        report.add(Severity::Warning, FindingCode::FrozenCamera, &stream.topic, first, detail);
    }
}

/// The number of messages that the steps of a stretch use. One message that is held for long is a gap instead.
fn messages(stream: &ImageStream, stretch: &Range<usize>) -> usize {
    let picks = stream.picks.get(stretch.clone()).unwrap_or_default();
    1 + picks.windows(2).filter(|pair| pair[0] != pair[1]).count()
}

/// Whether the robot moves in a stretch: by its proprioception, or without any by its actions.
fn moves(plan: &Plan, stretch: &Range<usize>) -> bool {
    let values = if plan.proprioception.is_empty() { &plan.action } else { &plan.proprioception };
    let width = values.len() / plan.stamps.len().max(1);
    let rows = values.get(stretch.start * width..stretch.end * width).unwrap_or_default();
    (0..width).any(|column| {
        let column = rows.iter().skip(column).step_by(width);
        let (low, high) = column.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &v| (low.min(v), high.max(v)));
        high - low > MOVED
    })
}
