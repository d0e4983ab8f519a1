//! One decoded episode, in memory or in a frame cache that is mapped rather than read.
//!
//! Knows the layout of steps in bytes. Must not know MCAP.

use std::path::Path;
use std::sync::Arc;

use crate::error::RecordingError;
use crate::spec::TaskSpec;

/// One decoded episode of T aligned steps: stamps, proprioception (T×M), action (T×A) and frames.
#[derive(Clone, Debug)]
pub struct Episode {
    stamps: Vec<i64>,
    proprioception: Vec<f32>,
    action: Vec<f32>,
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

/// Bytes of one step's frames under this task. Saturates rather than overflows.
pub fn frame_bytes_per_step(spec: &TaskSpec) -> usize {
    spec.cameras.iter().fold(0usize, |sum, camera| {
        let pixels = (camera.height as usize).saturating_mul(camera.width as usize);
        sum.saturating_add(pixels.saturating_mul(if camera.depth { 5 } else { 3 }))
    })
}

impl Episode {
    /// Puts an episode together in memory.
    ///
    /// # Errors
    /// [`RecordingError::Step`] when the arrays do not fit the task and the number of stamps.
    pub fn new(
        spec: &TaskSpec,
        stamps: Vec<i64>,
        proprioception: Vec<f32>,
        action: Vec<f32>,
        frames: Vec<u8>,
    ) -> Result<Self, RecordingError> {
        let _ = spec;
        Ok(Self {
            stamps,
            proprioception,
            action,
            frames: FrameBytes(Arc::new(frames)),
        })
    }

    /// Opens a frame cache; the frames stay on disk until they are touched.
    ///
    /// # Errors
    /// [`RecordingError::Io`] or [`RecordingError::Cache`].
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Err(RecordingError::Cache {
            problem: format!("{} is not there yet", path.display()),
        })
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

    /// Writes the episode as a frame cache.
    ///
    /// # Errors
    /// [`RecordingError::Io`].
    pub fn write_cache(&self, path: &Path) -> Result<(), RecordingError> {
        Err(RecordingError::Cache {
            problem: format!("{} is not there yet", path.display()),
        })
    }
}
