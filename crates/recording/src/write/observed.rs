//! Observations and actions one by one, as they come from a running robot: images are kept as they came, nothing is
//! coded again.

use std::io::{Seek, Write};

use super::EpisodeWriter;
use super::images::Kept;
use crate::error::RecordingError;
use crate::image::{PixelFormat, codec_name, decode_color, decode_depth, raw_size, without_ros_prefix};
use crate::picture::Channel;
use gleaner_core::CameraSpec;

/// One image in its original format.
#[derive(Clone, Copy, Debug)]
pub struct ImageRef<'a> {
    /// Its format.
    pub format: PixelFormat,
    /// Its bytes.
    pub data: &'a [u8],
}

/// The images of one camera.
#[derive(Clone, Copy, Debug)]
pub struct CameraRef<'a> {
    /// The color image.
    pub color: ImageRef<'a>,
    /// The depth image, if the camera has depth.
    pub depth: Option<ImageRef<'a>>,
}

/// The observation of a robot at one moment.
#[derive(Clone, Copy, Debug)]
pub struct ObservationRef<'a> {
    /// One for each camera of the task, in its order.
    pub cameras: &'a [CameraRef<'a>],
    /// M values.
    pub proprioception: &'a [f32],
}

impl<W: Write + Seek> EpisodeWriter<W> {
    /// Decodes every image and looks at every number: whether this could be a step of the task.
    ///
    /// # Errors
    /// [`RecordingError::Step`], `WrongSize` or `BrokenImage`.
    pub fn check(&self, observation: ObservationRef<'_>) -> Result<(), RecordingError> {
        self.check_observation(observation)?;
        for (camera, images) in self.spec.cameras.iter().zip(observation.cameras) {
            let sizes = camera.sizes();
            decode_color(images.color.data, images.color.format, &sizes)?;
            if let Some(depth) = images.depth {
                decode_depth(depth.data, depth.format, &sizes)?;
            }
        }
        Ok(())
    }

    /// Writes what was observed. It becomes a step by the action of the same stamp; without one it is kept all the
    /// same, but is no step. JPEG, PNG and WebP are kept byte for byte, and raw images exactly. They are not decoded
    /// here: [`EpisodeWriter::check`] does that.
    ///
    /// # Errors
    /// [`RecordingError::Step`] or `BrokenImage` when it does not fit the task, before anything is written;
    /// [`RecordingError::Write`].
    pub fn observe(&mut self, stamp_ns: i64, observation: ObservationRef<'_>) -> Result<(), RecordingError> {
        self.check_stamp(stamp_ns)?;
        self.check_observation(observation)?;
        let mut images = Vec::with_capacity(observation.cameras.len() * 2);
        for (at, camera) in observation.cameras.iter().enumerate() {
            images.push((at, Channel::Color, self.kept(at, Channel::Color, camera.color)?));
            if let Some(depth) = camera.depth {
                images.push((at, Channel::Depth, self.kept(at, Channel::Depth, depth)?));
            }
        }
        for (at, kind, image) in images {
            self.image(at, kind, stamp_ns, image)?;
        }
        self.state(stamp_ns, observation.proprioception)
    }

    /// Writes the action that was executed from this stamp on, and so ends the step that was observed then.
    ///
    /// # Errors
    /// [`RecordingError::Step`] if it does not fit the task, or [`RecordingError::Write`].
    pub fn act(&mut self, stamp_ns: i64, action: &[f32]) -> Result<(), RecordingError> {
        self.check_stamp(stamp_ns)?;
        self.check_numbers("action", action, self.spec.action_size())?;
        self.action(stamp_ns, action)
    }

    /// The stored format of an image.
    pub(super) fn kept<'a>(&self, at: usize, kind: Channel, image: ImageRef<'a>) -> Result<Kept<'a>, RecordingError> {
        let ImageRef { format, data } = image;
        let data = match (kind, format) {
            (Channel::Depth, PixelFormat::Auto) => without_ros_prefix(data),
            _ => data,
        };
        let format = match format {
            PixelFormat::Jpeg => Some("jpeg"),
            PixelFormat::Png => Some("png"),
            PixelFormat::Rgb8 | PixelFormat::Depth16 => None,
            PixelFormat::Auto => codec_name(data),
        };
        if let Some(format) = format {
            return Ok(Kept::Compressed(format, data));
        }
        let camera = &self.spec.cameras[at];
        let pixel_bytes = if kind == Channel::Color { 3 } else { 2 };
        let size = raw_size(data, pixel_bytes, &camera.sizes()).map_err(|mut error| {
            if let RecordingError::BrokenImage { problem } = &mut error {
                problem.insert_str(0, &format!("camera {}: ", camera.name));
            }
            error
        })?;
        Ok(Kept::Raw(size, data))
    }

    fn check_observation(&self, observation: ObservationRef<'_>) -> Result<(), RecordingError> {
        self.check_numbers("proprioception", observation.proprioception, self.spec.proprioception_size())?;
        let fits = |(wanted, found): (&CameraSpec, &CameraRef<'_>)| wanted.depth == found.depth.is_some();
        let cameras = observation.cameras;
        if self.spec.cameras.len() == cameras.len() && self.spec.cameras.iter().zip(cameras).all(fits) {
            return Ok(());
        }
        let problem = "the cameras are not the task's; give each its color, and its depth if it has depth";
        Err(self.wrong(problem.to_owned()))
    }

    /// Numbers that a reader of the recording would refuse are refused before they spoil it.
    pub(super) fn check_numbers(&self, what: &str, values: &[f32], wanted: usize) -> Result<(), RecordingError> {
        self.check_size(what, values.len(), wanted)?;
        match values.iter().position(|value| !value.is_finite()) {
            Some(at) => Err(self.wrong(format!("{what}[{at}] is {}; give finite numbers", values[at]))),
            None => Ok(()),
        }
    }
}
