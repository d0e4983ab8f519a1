//! Observations to steps: checks every field against the task's shape and decodes the images. Blocking work: except for
//! a few raw images, never on the runtime, never on a model's thread.

use std::sync::Arc;

use gleaner_learn::{CameraShape, TaskShape};
use gleaner_recording::{PixelFormat, decode_color, decode_depth};

use super::model::Step;
use crate::{
    domain::observation::{CameraFrame, Image, ImageFormat, Observation},
    error::{Error, Result},
};

/// Checks and decodes one observation; `path` is its place in the request. An empty executed action stays `None`.
///
/// # Errors
/// Invalid, naming the field and the fix.
pub(super) fn step(shape: &TaskShape, path: &str, observation: &Observation) -> Result<Step> {
    let Observation { stamp_ns: _, cameras, proprioception, executed_action, deadline: _, skipped_steps: _ } =
        observation;
    vector(&format!("{path}.proprioception"), proprioception, shape.proprioception)?;
    if !executed_action.is_empty() {
        vector(&format!("{path}.executed_action"), executed_action, shape.action)?;
    }
    let expected = names(shape);
    for (index, frame) in cameras.iter().enumerate() {
        let field = format!("{path}.cameras[{index}].camera");
        if !shape.cameras.iter().any(|camera| camera.name == frame.camera) {
            let found: String = frame.camera.chars().take(64).collect();
            return Err(Error::invalid(&field, format!("the task has no camera {found:?}; it has {expected}")));
        }
        if cameras[..index].iter().any(|before| before.camera == frame.camera) {
            return Err(Error::invalid(&field, format!("{} is duplicated; send each camera once", frame.camera)));
        }
    }
    let mut frame = Vec::with_capacity(shape.frame_bytes());
    for camera in &shape.cameras {
        let Some(index) = cameras.iter().position(|frame| frame.camera == camera.name) else {
            return Err(Error::invalid(
                &format!("{path}.cameras"),
                format!("camera {} is missing; the task needs {expected}", camera.name),
            ));
        };
        pixels(&mut frame, camera, &format!("{path}.cameras[{index}]"), &cameras[index])?;
    }
    Ok(Step {
        frame,
        proprioception: proprioception.clone(),
        executed: (!executed_action.is_empty()).then(|| executed_action.clone()),
    })
}

/// Appends one camera's pixels of a step: RGB, then depth if it has any.
fn pixels(into: &mut Vec<u8>, camera: &CameraShape, path: &str, frame: &CameraFrame) -> Result<()> {
    let sizes = camera.sizes();
    let field = format!("{path}.color");
    let color = present(&field, frame.color.as_ref())?;
    let format = pixel_format(color.format, PixelFormat::Rgb8);
    let raw_bytes = camera.height as usize * camera.width as usize * 3;
    if color.format == ImageFormat::Raw && camera.recorded.is_none() && color.data.len() == raw_bytes {
        into.extend_from_slice(&color.data);
    } else {
        into.extend(decode_color(&color.data, format, &sizes).map_err(|error| Error::invalid(&field, error))?);
    }

    let field = format!("{path}.depth");
    if !camera.depth {
        return match frame.depth {
            None => Ok(()),
            Some(_) => {
                Err(Error::invalid(&field, format!("camera {} has no depth in this task; leave it out", camera.name)))
            }
        };
    }
    let depth = present(&field, frame.depth.as_ref())?;
    if depth.format == ImageFormat::Jpeg {
        return Err(Error::invalid(&field, "depth cannot be JPEG, which is lossy; send PNG or RAW"));
    }
    let format = pixel_format(depth.format, PixelFormat::Depth16);
    into.extend(decode_depth(&depth.data, format, &sizes).map_err(|error| Error::invalid(&field, error))?);
    Ok(())
}

fn present<'a>(field: &str, image: Option<&'a Image>) -> Result<&'a Image> {
    image
        .filter(|image| !image.data.is_empty())
        .ok_or_else(|| Error::invalid(field, "is missing; send an image of the task's size"))
}

fn pixel_format(format: ImageFormat, raw: PixelFormat) -> PixelFormat {
    match format {
        ImageFormat::Any => PixelFormat::Auto,
        ImageFormat::Jpeg => PixelFormat::Jpeg,
        ImageFormat::Png => PixelFormat::Png,
        ImageFormat::Raw => raw,
    }
}

/// Checks the length and the values of a vector.
pub(crate) fn vector(field: &str, values: &[f32], length: usize) -> Result<()> {
    if values.len() != length {
        return Err(Error::invalid(field, format!("has {} values, the task has {length}", values.len())));
    }
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => {
            Err(Error::invalid(&format!("{field}[{index}]"), format!("is {}, must be finite", values[index])))
        }
    }
}

fn names(shape: &TaskShape) -> String {
    shape.cameras.iter().map(|camera| camera.name.as_str()).collect::<Vec<_>>().join(", ")
}

/// Decodes the images of an observation that is not sent to a policy.
///
/// # Errors
/// Invalid, naming the field from `path` on.
pub(crate) async fn frames(shape: Arc<TaskShape>, path: &'static str, observation: Observation) -> Result<Vec<u8>> {
    decode(move || step(&shape, path, &observation).map(|step| step.frame)).await
}

/// Up to this many bytes of images, copying takes less time than waking another thread.
const SMALL: usize = 512 << 10;

/// As [`step`], for callers that must not block: raw images of a small task are decoded at once, all others off the
/// runtime.
///
/// # Errors
/// As [`step`].
pub(super) async fn step_of(shape: Arc<TaskShape>, path: &'static str, observation: Observation) -> Result<Step> {
    if is_quick(&shape, &observation) {
        return step(&shape, path, &observation);
    }
    decode(move || step(&shape, path, &observation)).await
}

/// Whether decoding an observation takes no longer than waking another thread: nothing to decompress or to resize.
fn is_quick(shape: &TaskShape, observation: &Observation) -> bool {
    let raw = |image: &Option<Image>| image.as_ref().is_none_or(|image| image.format == ImageFormat::Raw);
    let unchanged = shape.cameras.iter().all(|camera| camera.recorded.is_none());
    shape.frame_bytes() <= SMALL
        && unchanged
        && observation.cameras.iter().all(|frame| raw(&frame.color) && raw(&frame.depth))
}

/// Runs decoding off the runtime.
///
/// # Errors
/// The error of `work`.
pub(super) async fn decode<T: Send + 'static>(work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(|error| Error::internal("decoding an observation", error))?
}

/// A blank observation, to warm a model up with.
pub(super) fn blank(shape: &TaskShape) -> Step {
    Step { frame: vec![0; shape.frame_bytes()], proprioception: vec![0.0; shape.proprioception], executed: None }
}

#[cfg(test)]
mod tests;
