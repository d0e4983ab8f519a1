//! Contact sheets: single segments, each with the image of its last step.

use gleaner_core::{CameraSpec, curation::SegmentRef, id::ScoreRunId};
use maud::{Markup, html};

use crate::{link, page_request::escaped, standing::Standings};

/// Segments of a sheet.
pub(super) const SEGMENTS: usize = 12;
/// The most pixels of an image.
const SIZE: u32 = 256;

/// A sheet of a run's segments, each linked to its step; images are of this camera, if the task has one. A segment of a
/// permanently deleted episode has neither.
pub(super) fn sheet(
    run: &ScoreRunId,
    camera: Option<&CameraSpec>,
    segments: &[SegmentRef],
    standings: &Standings,
) -> Markup {
    let caption = |SegmentRef { episode_id, end_step, q }: &SegmentRef| {
        html! {
            span.q { "q " (format!("{q:.3}")) }
            span.soft { (link::short(episode_id.as_str())) ", step " (end_step) (standings.tag(episode_id)) }
        }
    };
    html! {
        ul.contact {
            @for segment @ SegmentRef { episode_id, end_step, .. } in segments {
                li {
                    @if standings.has_page(episode_id) {
                        a href=(format!("/episodes/{episode_id}?run={run}&step={end_step}")) {
                            @if let Some(camera) = camera {
                                img loading="lazy" width=(camera.width) height=(camera.height) alt=(format!("Step {end_step} of {episode_id}"))
                                    src=(format!("/episodes/{episode_id}/frames/{}/{end_step}?size={SIZE}", escaped(&camera.name)));
                            }
                            (caption(segment))
                        }
                    } @else {
                        div { (caption(segment)) }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use gleaner_core::id::EpisodeId;

    use super::*;

    #[test]
    fn each_segment_links_to_its_step_and_run() {
        let (run, episode_id) = (ScoreRunId::new(), EpisodeId::new());
        let segment = SegmentRef { episode_id: episode_id.clone(), end_step: 17, q: 0.25 };
        let present = Standings::default();
        let camera = CameraSpec { name: "front cam".into(), height: 48, width: 64, depth: false, recorded: None };
        let shown = sheet(&run, Some(&camera), std::slice::from_ref(&segment), &present).into_string();
        assert!(shown.contains(&format!("href=\"/episodes/{episode_id}?run={run}&amp;step=17\"")), "{shown}");
        assert!(
            shown.contains("/frames/front%20cam/17?") && shown.contains("q 0.250") && shown.contains("width=\"64\""),
            "{shown}"
        );
        assert!(!sheet(&run, None, &[segment], &present).into_string().contains("<img"));
    }
}
