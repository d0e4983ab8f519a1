//! Video without a key frame, or with one that comes late.

use crate::tracks::Tracks;
use gleaner_core::{FindingCode, Report, Severity, TaskSpec};

/// Reports the topics of video whose pictures do not begin with the first message.
pub(crate) fn key_frames(tracks: &Tracks, spec: &TaskSpec, mapping: usize, report: &mut Report) {
    for camera in &spec.mappings[mapping].cameras {
        let track = tracks.tracks.get(&camera.color);
        let Some(reel) = track.and_then(|track| track.reel.as_ref()).filter(|reel| reel.is_video()) else {
            continue;
        };
        let Some(&first) = reel.pictures().first() else {
            let reason = reel.failure().map(|error| format!(" ({error})")).unwrap_or_default();
            let detail = format!(
                "no message is a key frame{reason}, so no picture can be decoded; let the encoder write key frames, with \
                 their parameter sets"
            );
            report.add(Severity::Error, FindingCode::BrokenImage, &camera.color, None, detail);
            continue;
        };
        if first > 0 {
            let detail = format!(
                "the first key frame is message {first}, and the {first} messages before it have no picture; steps begin \
                 after them. Begin recording with a key frame, or write key frames more often"
            );
            report.add(Severity::Note, FindingCode::LateKeyFrame, &camera.color, None, detail);
        }
    }
}
