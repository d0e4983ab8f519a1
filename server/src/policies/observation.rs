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
mod tests {
    use super::*;
    use crate::error::Kind;

    fn shape() -> TaskShape {
        let camera = |name: &str, depth| CameraShape { name: name.into(), height: 8, width: 16, depth, recorded: None };
        TaskShape {
            cameras: vec![camera("top", true), camera("wrist", false)],
            proprioception: 2,
            action: 1,
            ranges: gleaner_core::action::ActionRanges::default(),
        }
    }

    fn raw(data: Vec<u8>) -> Option<Image> {
        Some(Image { format: ImageFormat::Raw, data: data.into() })
    }

    fn frame(camera: &str, color: Option<Image>, depth: Option<Image>) -> CameraFrame {
        CameraFrame { camera: camera.into(), color, depth }
    }

    /// A valid observation; its cameras are in another order than the task's.
    fn right() -> Observation {
        Observation {
            stamp_ns: 1,
            cameras: vec![frame("wrist", raw(vec![3; 384]), None), frame("top", raw(vec![1; 384]), raw(vec![2; 256]))],
            proprioception: vec![0.5, -0.5],
            executed_action: Vec::new(),
            deadline: None,
            skipped_steps: 0,
        }
    }

    #[test]
    fn pixels_are_in_the_order_of_the_task() {
        let step = step(&shape(), "observation", &right()).unwrap();
        assert_eq!(step.frame, [vec![1; 384], vec![2; 256], vec![3; 384]].concat());
        assert_eq!(step.proprioception, [0.5, -0.5]);
        assert_eq!(step.executed, None);
    }

    #[test]
    fn jpeg_is_decoded_to_the_size_of_the_task() {
        let jpeg = gleaner_recording::encode_jpeg(&[200; 384], 8, 16, 90).unwrap();
        let mut observation = right();
        observation.cameras[0].color = Some(Image { format: ImageFormat::Any, data: jpeg.into() });
        let step = step(&shape(), "observation", &observation).unwrap();
        assert_eq!(step.frame.len(), shape().frame_bytes());
        assert!(step.frame[640..].iter().all(|&byte| byte.abs_diff(200) < 8));
    }

    /// Training reads `decode_color`, so equal bytes here mean that a model is served what it was trained on.
    #[tokio::test]
    async fn pictures_of_the_recorded_size_become_those_of_a_step() {
        let recorded = gleaner_recording::RecordedSize { height: 16, width: 40, crop: None };
        let mut shape = shape();
        shape.cameras[1].recorded = Some(recorded);
        let large: Vec<u8> = (0..16 * 40 * 3).map(|at| u8::try_from(at * 7 % 256).unwrap()).collect();
        let small = decode_color(&large, PixelFormat::Rgb8, &shape.cameras[1].sizes()).unwrap();
        for sent in [&large, &small] {
            let mut observation = right();
            observation.cameras[0].color = raw(sent.clone());
            assert!(!is_quick(&shape, &observation));
            let step = step_of(Arc::new(shape.clone()), "observation", observation).await.unwrap();
            assert_eq!(step.frame[640..], small);
        }
    }

    #[tokio::test]
    async fn a_few_raw_images_are_decoded_at_once_and_others_off_the_runtime() {
        let of = |shape: TaskShape, observation| step_of(Arc::new(shape), "observation", observation);
        assert!(is_quick(&shape(), &right()));
        let at_once = of(shape(), right()).await.unwrap();
        assert_eq!(at_once.frame, step(&shape(), "observation", &right()).unwrap().frame);

        let jpeg = gleaner_recording::encode_jpeg(&[200; 384], 8, 16, 90).unwrap();
        let mut compressed = right();
        compressed.cameras[0].color = Some(Image { format: ImageFormat::Jpeg, data: jpeg.into() });
        assert!(!is_quick(&shape(), &compressed));
        assert_eq!(of(shape(), compressed).await.unwrap().frame.len(), shape().frame_bytes());

        let large = TaskShape {
            cameras: vec![CameraShape { name: "top".into(), height: 512, width: 512, depth: false, recorded: None }],
            ..shape()
        };
        let mut observation = right();
        observation.cameras = vec![frame("top", raw(vec![0; 512 * 512 * 3]), None)];
        assert!(!is_quick(&large, &observation));
        assert_eq!(of(large, observation).await.unwrap().frame.len(), 512 * 512 * 3);
    }

    #[test]
    fn every_bad_observation_is_named_by_its_field() {
        type Spoil = fn(&mut Observation);
        let jpeg = |data: Vec<u8>| Some(Image { format: ImageFormat::Jpeg, data: data.into() });
        let wrong_size = gleaner_recording::encode_jpeg(&[0; 192], 8, 8, 90).unwrap();
        let mut small = right();
        small.cameras[0].color = jpeg(wrong_size);
        let error = step(&shape(), "observation", &small).unwrap_err();
        assert!(error.message().starts_with("observation.cameras[0].color: "), "{error}");
        assert!(error.message().contains("8×8"), "{error}");

        let cases: [(&str, Spoil); 15] = [
            ("observation.cameras: camera top", |o| o.cameras.truncate(1)),
            ("observation.cameras[0].camera", |o| o.cameras[0].camera = "left".into()),
            ("observation.cameras[1].camera", |o| o.cameras[1].camera = "wrist".into()),
            ("observation.cameras[0].color", |o| o.cameras[0].color = None),
            ("observation.cameras[0].color", |o| o.cameras[0].color = raw(vec![0; 383])),
            ("observation.cameras[0].color", |o| o.cameras[0].color = raw(Vec::new())),
            ("observation.cameras[1].color", |o| {
                let broken = vec![0xFF, 0xD8, 0xFF, 0xE0, 1, 2, 3];
                o.cameras[1].color = Some(Image { format: ImageFormat::Jpeg, data: broken.into() });
            }),
            ("observation.cameras[1].depth", |o| o.cameras[1].depth = None),
            ("observation.cameras[1].depth", |o| o.cameras[1].depth = raw(vec![0; 255])),
            ("observation.cameras[1].depth", |o| {
                o.cameras[1].depth = Some(Image { format: ImageFormat::Jpeg, data: vec![0; 256].into() });
            }),
            ("observation.cameras[0].depth", |o| o.cameras[0].depth = raw(vec![0; 256])),
            ("observation.proprioception: ", |o| o.proprioception.truncate(1)),
            ("observation.proprioception[1]: ", |o| o.proprioception[1] = f32::INFINITY),
            ("observation.executed_action: ", |o| o.executed_action = vec![0.0; 2]),
            ("observation.executed_action[0]: ", |o| o.executed_action = vec![f32::NAN]),
        ];
        for (field, spoil) in cases {
            let mut observation = right();
            spoil(&mut observation);
            let error = step(&shape(), "observation", &observation).unwrap_err();
            assert_eq!(error.kind(), Kind::Invalid);
            assert!(error.message().starts_with(field), "{field} expected: {error}");
        }
    }
}
