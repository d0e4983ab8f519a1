//! A decoded episode in memory, for short recordings and tests, and the layout of a step's images.
//!
//! This module does not depend on MCAP or on the format of frame caches.

use std::sync::Arc;

use crate::error::RecordingError;
use crate::picture::Channel;
use gleaner_core::TaskSpec;

/// One decoded episode of T aligned steps: stamps, proprioception (T×M), action (T×A) and frames.
#[derive(Clone, Debug)]
pub struct Episode {
    pub(crate) stamps: Vec<i64>,
    pub(crate) proprioception: Vec<f32>,
    pub(crate) action: Vec<f32>,
    frames: FrameBytes,
}

/// The frames of an episode: for each step, for each camera in the task's order, height × width × 3 bytes of
/// RGB and then, if the camera has depth, height × width 16-bit little-endian millimetres. Cheap to clone.
#[derive(Clone, Debug)]
pub struct FrameBytes(Arc<Vec<u8>>);

impl AsRef<[u8]> for FrameBytes {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

/// One image of a step: a stream of pictures of this form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Picture {
    /// Where the image begins within the step's frames.
    pub(crate) offset: usize,
    /// Bytes of the image.
    pub(crate) bytes: usize,
    /// Bytes of one of its rows.
    pub(crate) row_bytes: usize,
}

/// The images of a step, in their order: of each camera its color and then, if it has depth, its depth.
pub(crate) fn pictures(spec: &TaskSpec) -> Vec<Picture> {
    let (mut pictures, mut offset) = (Vec::new(), 0);
    for camera in &spec.cameras {
        for channel in [Channel::Color, Channel::Depth] {
            if channel == Channel::Color || camera.depth {
                let bytes = channel.bytes(camera);
                pictures.push(Picture { offset, bytes, row_bytes: bytes / (camera.height as usize).max(1) });
                offset += bytes;
            }
        }
    }
    pictures
}

/// Bytes of one step's frames under this task. Saturates rather than overflows.
pub fn frame_bytes_per_step(spec: &TaskSpec) -> usize {
    spec.cameras.iter().fold(0usize, |sum, camera| {
        let pixels = (camera.height as usize).saturating_mul(camera.width as usize);
        sum.saturating_add(pixels.saturating_mul(if camera.depth { 5 } else { 3 }))
    })
}

impl Episode {
    /// Creates an episode in memory.
    ///
    /// # Errors
    /// [`RecordingError::Step`] if an array does not fit the task and the number of stamps.
    pub fn new(
        spec: &TaskSpec,
        stamps: Vec<i64>,
        proprioception: Vec<f32>,
        action: Vec<f32>,
        frames: Vec<u8>,
    ) -> Result<Self, RecordingError> {
        let lengths = [
            ("proprioception", proprioception.len(), spec.proprioception_size()),
            ("action", action.len(), spec.action_size()),
            ("frames", frames.len(), frame_bytes_per_step(spec)),
        ];
        for (what, found, per_step) in lengths {
            if stamps.len().checked_mul(per_step) != Some(found) {
                let problem = format!(
                    "{what} has {found} elements, but {} steps of {per_step} are expected; fill every step",
                    stamps.len()
                );
                return Err(RecordingError::Step { step: stamps.len() as u64, problem });
            }
        }
        Ok(Self { stamps, proprioception, action, frames: FrameBytes(Arc::new(frames)) })
    }

    /// Number of steps T.
    pub fn steps(&self) -> usize {
        self.stamps.len()
    }

    /// Each step's stamp in nanoseconds.
    pub fn stamps(&self) -> &[i64] {
        &self.stamps
    }

    /// T×M values, row-major.
    pub fn proprioception(&self) -> Vec<f32> {
        self.proprioception.clone()
    }

    /// T×A values, row-major.
    pub fn action(&self) -> Vec<f32> {
        self.action.clone()
    }

    /// All frames; a cheap handle.
    pub fn frames(&self) -> FrameBytes {
        self.frames.clone()
    }
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::testing::arm;

    #[test]
    fn a_step_holds_color_then_depth_of_each_camera() {
        assert_eq!(frame_bytes_per_step(&arm()), 8 * 16 * 3 + 8 * 16 * 2);
        let mut huge = arm();
        huge.cameras[0].height = u32::MAX;
        huge.cameras[0].width = u32::MAX;
        assert_eq!(frame_bytes_per_step(&huge), usize::MAX);
    }

    #[test]
    fn pictures_fill_a_step_in_order() {
        let mut spec = arm();
        let second =
            gleaner_core::CameraSpec { name: "hand".into(), height: 2, width: 4, depth: false, recorded: None };
        spec.cameras.push(second);
        let found: Vec<_> = pictures(&spec).iter().map(|one| (one.offset, one.bytes, one.row_bytes)).collect();
        assert_eq!(found, [(0, 384, 48), (384, 256, 32), (640, 24, 12)]);
        assert_eq!(frame_bytes_per_step(&spec), 664);
    }

    #[test]
    fn arrays_that_do_not_fit_are_refused_by_name() {
        let step = frame_bytes_per_step(&arm());
        let build = |m, a, o| Episode::new(&arm(), vec![1, 2], vec![0.0; m], vec![0.0; a], vec![0; o]);
        assert_eq!(build(6, 4, 2 * step).unwrap().steps(), 2);
        assert!(build(5, 4, 2 * step).unwrap_err().to_string().contains("proprioception"));
        assert!(build(6, 3, 2 * step).unwrap_err().to_string().contains("action"));
        assert!(build(6, 4, step).unwrap_err().to_string().contains("frames"));
    }
}
