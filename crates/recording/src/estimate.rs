//! What an inspection takes, estimated from a recording's own summary and its task: before the recording is sent.
//!
//! The numbers are bounds where the file's times are those of its steps. They do not depend on the data of the recording.

use std::path::Path;

use crate::container;
use crate::error::RecordingError;
use crate::frames::pictures;
use crate::plan::choice;
use crate::tracks::Stamp;
use gleaner_core::{CameraSpec, InspectionEstimate, Mapping, RecordingSummary, TaskSpec};

pub use crate::tracks::MAX_MESSAGES;

/// Decoded pictures of a simulator take at least this part of their pixels: an eighth where the camera moves, and a fifth
/// of that or less where it stands still (docs/decisions/0036-frames-are-cached-compressed.md and
/// 0059-cameras-that-stand-still-are-cached-as-differences.md).
const LEAST_SHARE: u64 = 64;

/// Reads what a recording states about itself in its summary section, at its end; `None` where it has no whole and
/// consistent one. The other bytes are not read.
///
/// # Errors
/// [`RecordingError::Io`]; `Empty` and `NotMcap` for other files.
pub fn summarize(path: &Path) -> Result<Option<RecordingSummary>, RecordingError> {
    container::summary(path)
}

/// Estimates what an inspection of such a recording takes: by the mapping with the least steps among those whose topics
/// all have messages; everything is 0 without one.
pub fn estimate(summary: &RecordingSummary, spec: &TaskSpec) -> InspectionEstimate {
    let spec = &*choice::readable(spec);
    let messages = |topic: &str| summary.topics.get(topic).copied().unwrap_or_default();
    let fits = |mapping: &&Mapping| mapping.topics(spec).iter().all(|topic| messages(topic) > 0);
    let fitting = spec.mappings.iter().filter(fits);
    let Some((mapping, steps)) =
        fitting.map(|mapping| (mapping, steps(summary, spec, mapping))).min_by_key(|(_, steps)| *steps)
    else {
        return InspectionEstimate::default();
    };
    let topics = mapping.topics(spec).into_iter();
    let stamps = topics.map(messages).fold(0_u64, u64::saturating_add);
    let least_memory_bytes = stamps.saturating_mul(size_of::<Stamp>() as u64);
    let most_decoded_bytes = decoded_bytes(spec, mapping, steps, &messages);
    let least_decoded_bytes = most_decoded_bytes / LEAST_SHARE;
    InspectionEstimate { steps, least_memory_bytes, least_decoded_bytes, most_decoded_bytes }
}

/// Pixels of all pictures that reading such a recording decodes, as it has them: by the mapping with the most of them. The
/// statement may be false; the caller limits what follows from it.
pub fn decoded_pixels(summary: &RecordingSummary, spec: &TaskSpec) -> u64 {
    let spec = &*choice::readable(spec);
    let messages = |topic: &str| summary.topics.get(topic).copied().unwrap_or_default();
    let of_camera = |mapping: &Mapping, camera: &CameraSpec| {
        let source = mapping.cameras.iter().find(|source| source.camera == camera.name)?;
        let depth = source.depth.as_deref().filter(|_| camera.depth);
        let pictures = messages(&source.color).saturating_add(depth.map_or(0, messages));
        let (height, width) = camera
            .recorded
            .as_ref()
            .map_or((camera.height, camera.width), |recorded| (recorded.height, recorded.width));
        Some(pictures.saturating_mul(u64::from(height) * u64::from(width)))
    };
    let of_mapping = |mapping: &Mapping| {
        spec.cameras.iter().filter_map(|camera| of_camera(mapping, camera)).fold(0, u64::saturating_add)
    };
    spec.mappings.iter().map(of_mapping).max().unwrap_or_default()
}

/// At most one step for each message of the clock, and for each period of the task's rate.
fn steps(summary: &RecordingSummary, spec: &TaskSpec, mapping: &Mapping) -> u64 {
    let ticks = mapping.clock_topic(spec).and_then(|topic| summary.topics.get(topic)).copied().unwrap_or_default();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_precision_loss,
        clippy::cast_sign_loss,
        reason = "a conversion of floats saturates, and an estimate needs no more than their digits"
    )]
    let periods = (summary.duration_ns as f64 / 1e9 * spec.rate_hz) as u64;
    ticks.min(periods.saturating_add(1))
}

/// Bytes of the pixels that the steps show; a picture that several steps show counts once.
fn decoded_bytes(spec: &TaskSpec, mapping: &Mapping, steps: u64, messages: &dyn Fn(&str) -> u64) -> u64 {
    let source = |name: &str| mapping.cameras.iter().find(|source| source.camera == name);
    let mut bytes = 0_u64;
    let mut forms = pictures(spec).into_iter();
    for camera in &spec.cameras {
        let topics = source(&camera.name).map(|source| [Some(source.color.as_str()), source.depth.as_deref()]);
        for topic in topics.into_iter().flatten().take(if camera.depth { 2 } else { 1 }) {
            let (Some(form), Some(topic)) = (forms.next(), topic) else { continue };
            bytes = bytes.saturating_add(steps.min(messages(topic)).saturating_mul(form.bytes as u64));
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use gleaner_core::RecordedSize;

    use super::*;
    use crate::testing::arm;

    fn summary(seconds: u64, command: u64, images: u64) -> RecordingSummary {
        let topics = [
            ("/joints", command),
            ("/tool", command),
            ("/command", command),
            ("/front/color", images),
            ("/front/depth", images),
            ("/other", 1_000_000),
        ];
        let topics = BTreeMap::from(topics.map(|(topic, count)| (topic.to_owned(), count)));
        RecordingSummary { duration_ns: seconds * 1_000_000_000, topics, ..RecordingSummary::default() }
    }

    #[test]
    fn steps_follow_the_rate_and_the_clock() {
        // 10 Hz for 60 s, from a clock of 50 Hz; pictures at 5 Hz.
        let found = estimate(&summary(60, 3000, 300), &arm());
        assert_eq!(found.steps, 601);
        assert_eq!(found.most_decoded_bytes, 300 * (8 * 16 * 3 + 8 * 16 * 2));
        assert_eq!(found.least_decoded_bytes, found.most_decoded_bytes / LEAST_SHARE);
        assert_eq!(found.least_memory_bytes, (3 * 3000 + 2 * 300) * 24);
        // A clock slower than the rate.
        assert_eq!(estimate(&summary(60, 100, 600), &arm()).steps, 100);
    }

    #[test]
    fn every_picture_of_a_camera_is_decoded_at_its_recorded_size() {
        let mut spec = arm();
        assert_eq!(decoded_pixels(&summary(60, 3000, 300), &spec), 2 * 300 * 8 * 16);
        spec.cameras[0].recorded = Some(RecordedSize { height: 480, width: 640, crop: None });
        assert_eq!(decoded_pixels(&summary(60, 3000, 300), &spec), 2 * 300 * 480 * 640);
        spec.cameras[0].depth = false;
        assert_eq!(decoded_pixels(&summary(60, 3000, 300), &spec), 300 * 480 * 640);
        assert_eq!(decoded_pixels(&RecordingSummary::default(), &spec), 0);
    }

    #[test]
    fn recordings_without_a_fitting_mapping_have_no_estimate() {
        let mut without = summary(60, 600, 600);
        without.topics.remove("/tool");
        assert_eq!(estimate(&without, &arm()), InspectionEstimate::default());
    }

    #[test]
    fn numbers_beyond_any_file_do_not_overflow() {
        let mut huge = summary(1, u64::MAX, u64::MAX);
        huge.duration_ns = u64::MAX;
        let found = estimate(&huge, &arm());
        assert!(found.steps > 1_000_000_000 && found.least_memory_bytes == u64::MAX, "{found:?}");
    }

    #[test]
    fn estimates_of_written_recordings_bound_their_caches() {
        let (folder, spec) = (tempfile::tempdir().unwrap(), crate::write::tests::written_arm());
        let (path, cache) = (folder.path().join("a.mcap"), folder.path().join("frames"));
        std::fs::write(&path, crate::write::tests::written(40)).unwrap();
        let found = estimate(&summarize(&path).unwrap().unwrap(), &spec);
        let report =
            crate::cache_episode(&path, &spec, (&crate::Limits::default(), crate::ImageThreads::NONE), &cache).unwrap();
        assert_eq!((found.steps, report.steps), (40, 40));
        let rows = 1000 + 40 * 100;
        let bytes = std::fs::metadata(&cache).unwrap().len();
        assert!(bytes < found.most_decoded_bytes + rows, "{bytes}: {found:?}");
    }
}
