//! Cameras: which topics are color and which depth, and which of several ways are the same camera.
//!
//! Works on ways alone.

use gleaner_recording::{CameraSource, CameraSpec, RecordedSize};

use super::candidate::LeftOut;
use super::tokens::{camera_name, likeness};
use super::way::{Way, WayTopic};
use crate::words::counted;

/// Longest side of a step's picture in a draft: models read it in reasonable time.
const STEP_SIDE: u32 = 128;

/// A camera of the draft.
#[derive(Debug)]
pub(super) struct Camera {
    pub(super) spec: CameraSpec,
    /// Its topics in each way.
    pub(super) sources: Vec<CameraSource>,
    /// How it was found.
    pub(super) reasons: Vec<String>,
}

struct Found<'a> {
    name: String,
    color: &'a WayTopic,
    depth: Option<&'a WayTopic>,
}

/// The cameras that all ways have.
pub(super) fn cameras(ways: &[Way], left_out: &mut Vec<LeftOut>) -> Vec<Camera> {
    let mut found: Vec<Vec<Found<'_>>> = ways.iter().map(|way| of_way(way, left_out)).collect();
    let Some(first) = found.first_mut().map(std::mem::take) else { return Vec::new() };
    let mut cameras: Vec<Camera> = Vec::new();
    for camera in first {
        let mut everywhere = Vec::new();
        for others in found.iter_mut().skip(1) {
            everywhere.extend(take_alike(&camera, others));
        }
        if everywhere.len() + 1 < ways.len() {
            left_out.push(LeftOut {
                what: camera.color.found.topic.clone(),
                reason: "no camera of this size is in every way of recording".to_owned(),
            });
            continue;
        }
        let same: Vec<Found<'_>> = std::iter::once(camera).chain(everywhere).collect();
        let taken = |name: &str| cameras.iter().any(|camera| camera.spec.name == name);
        let mut name = same[0].name.clone();
        if taken(&name) {
            name = format!("{name}_{}", cameras.len() + 1);
        }
        cameras.push(camera_of(name, &same));
    }
    for (way, rest) in ways.iter().zip(&found) {
        left_out.extend(rest.iter().map(|camera| LeftOut {
            what: format!("{} ({})", camera.color.found.topic, way.name),
            reason: "the other ways of recording have no such camera".to_owned(),
        }));
    }
    cameras
}

fn size(topic: &WayTopic) -> (u32, u32) {
    topic.found.camera.as_ref().map_or((0, 0), |camera| (camera.height, camera.width))
}

fn of_way<'a>(way: &'a Way, left_out: &mut Vec<LeftOut>) -> Vec<Found<'a>> {
    let whole = |topic: &&WayTopic| size(topic).0 > 0;
    let (mut colors, mut depths) = (Vec::new(), Vec::new());
    for topic in way.topics.iter().filter(whole) {
        let name = &topic.found.topic;
        if topic.recordings < way.recordings {
            let reason = format!("only {} of {} recordings have it", topic.recordings, way.recordings);
            left_out.push(LeftOut { what: format!("{name} ({})", way.name), reason });
        } else if topic.found.camera.as_ref().is_some_and(|camera| camera.depth) {
            depths.push(topic);
        } else {
            colors.push(topic);
        }
    }
    let mut found: Vec<Found<'a>> = Vec::new();
    for color in colors {
        let name = camera_name(&color.found.topic);
        // The same pictures are often recorded raw and compressed; the first topic counts.
        if let Some(twin) = found.iter().find(|known| known.name == name && size(known.color) == size(color)) {
            let reason = format!("it shows the camera of {} again", twin.color.found.topic);
            left_out.push(LeftOut { what: format!("{} ({})", color.found.topic, way.name), reason });
            continue;
        }
        let fits = |depth: &&WayTopic| size(depth) == size(color) && camera_name(&depth.found.topic) == name;
        let depth = depths.iter().position(fits).map(|at| depths.remove(at));
        found.push(Found { name, color, depth });
    }
    if let ([camera], [depth]) = (found.as_mut_slice(), depths.as_slice())
        && camera.depth.is_none()
        && size(camera.color) == size(depth)
    {
        camera.depth = depths.pop();
    }
    left_out.extend(depths.into_iter().map(|depth| LeftOut {
        what: format!("{} ({})", depth.found.topic, way.name),
        reason: "no color image of its size belongs to it".to_owned(),
    }));
    found
}

/// Takes the camera of the same size whose name is likest.
fn take_alike<'a>(camera: &Found<'_>, others: &mut Vec<Found<'a>>) -> Option<Found<'a>> {
    let fits = |other: &Found<'_>| size(other.color) == size(camera.color);
    let alike = |other: &Found<'_>| likeness(&other.name, &camera.name);
    let best = others.iter().enumerate().filter(|(_, other)| fits(other));
    let (at, _) = best.max_by(|(_, one), (_, other)| alike(one).total_cmp(&alike(other)))?;
    let only = others.len() == 1;
    (only || alike(&others[at]) > 0.0).then(|| others.remove(at))
}

fn camera_of(name: String, same: &[Found<'_>]) -> Camera {
    let depth = same.iter().all(|found| found.depth.is_some());
    let (height, width) = size(same[0].color);
    let step = step_size(height, width);
    let recorded = (step != (height, width)).then_some(RecordedSize { height, width, crop: None });
    let mut reasons = Vec::new();
    let format = same[0].color.found.camera.as_ref().map_or("", |camera| camera.encoding.as_str());
    reasons.push(format!("{} holds pictures of {height}×{width} pixels ({format}).", same[0].color.found.topic));
    let others = same.iter().flat_map(|found| &found.color.sizes).filter(|other| **other != (height, width)).count();
    if others > 0 {
        reasons.push(format!(
            "{} another size and would be refused.",
            counted(others, "recording has", "recordings have")
        ));
    }
    if recorded.is_some() {
        let (height, width) = step;
        reasons.push(format!("Models read it scaled to {height}×{width}; larger ones show more and train slower."));
    }
    if !depth && same.iter().any(|found| found.depth.is_some()) {
        reasons.push("Its depth is left out, because not every way of recording has it.".to_owned());
    }
    let source = |found: &Found<'_>| CameraSource {
        camera: name.clone(),
        color: found.color.found.topic.clone(),
        depth: found.depth.filter(|_| depth).map(|depth| depth.found.topic.clone()),
    };
    let sources = same.iter().map(source).collect();
    let spec = CameraSpec { name, height: step.0, width: step.1, depth, recorded };
    Camera { spec, sources, reasons }
}

/// The size of a step's picture: that of the recording, or one with the same shape and a longest side of 128 pixels.
pub(super) fn step_size(height: u32, width: u32) -> (u32, u32) {
    let longest = height.max(width);
    if longest <= STEP_SIDE {
        return (height, width);
    }
    let side = |side: u32| {
        let scaled = u64::from(side) * u64::from(STEP_SIDE) / u64::from(longest);
        // Multiples of four halve evenly in the image encoders.
        u32::try_from(scaled).unwrap_or(STEP_SIDE).div_ceil(4).max(1) * 4
    };
    (side(height), side(width))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_pictures_keep_their_shape() {
        assert_eq!(step_size(128, 128), (128, 128));
        assert_eq!(step_size(480, 640), (96, 128));
        assert_eq!(step_size(720, 1280), (72, 128));
        assert_eq!(step_size(8000, 10), (128, 4));
    }
}
