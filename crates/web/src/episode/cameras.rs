//! The cameras side by side, and the controls that step through them.

use maud::{Markup, html};

use super::View;
use crate::frames;

/// An image of the step for each camera, and another for each depth.
pub(super) fn figures(view: &View) -> Markup {
    let cameras = &view.task.spec.cameras;
    html! {
        @if cameras.is_empty() {
            p.panel.empty { "This task has no camera. Its other values are plotted below." }
        }
        div.cameras {
            @for camera in cameras {
                (figure(view, &camera.name, camera.width, camera.height, false))
                @if camera.depth { (figure(view, &camera.name, camera.width, camera.height, true)) }
            }
        }
    }
}

fn figure(view: &View, camera: &str, width: u32, height: u32, depth: bool) -> Markup {
    let before = frames::before_step(view.id(), camera);
    let after = if depth { "?depth=true" } else { "" };
    html! {
        figure.camera {
            img data-before=(before) data-after=(after) src=(format!("{before}{}{after}", view.step))
                width=(width) height=(height)
                alt=(format!("{}{camera} at the current step", if depth { "Depth of " } else { "" }));
            figcaption { (camera) @if depth { ", depth" } }
        }
    }
}

/// The slider with its buttons.
pub(super) fn scrubber(view: &View, times: &[f64]) -> Markup {
    let last = view.inspected.episode.steps.saturating_sub(1);
    let time = usize::try_from(view.step).ok().and_then(|step| times.get(step)).copied().unwrap_or(0.0);
    html! {
        div.scrubber.panel {
            button #play.primary type="button" aria-pressed="false" { "Play" }
            label.unseen for="step" { "Step" }
            input #step type="range" min="0" max=(last) value=(view.step) step="1";
            output #at for="step" { "step " (view.step) " of " (last) " · " (format!("{time:.2}")) " s" }
        }
        p.formats.hint { kbd { "Space" } " plays, " kbd { "←" } " " kbd { "→" } " move by one step, with Shift by ten. Click a plot to jump to a step." }
    }
}
