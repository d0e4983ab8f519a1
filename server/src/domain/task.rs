//! Tasks: a named skill with its spec.

use gleaner_learn::{CameraShape, TaskShape};
use gleaner_recording::TaskSpec;

use super::{id::TaskId, time::Millis};

/// A named robot skill, and how its steps are found in a recording.
#[derive(Debug, Clone)]
pub struct Task {
    /// Its id.
    pub id: TaskId,
    /// What a step holds, and where recordings keep it. Immutable.
    pub spec: TaskSpec,
    /// When it was created.
    pub created_at: Millis,
}

/// How many episodes a task has, by outcome.
#[derive(Debug, Clone, Copy, Default)]
pub struct OutcomeCounts {
    /// Labelled success.
    pub success: u64,
    /// Labelled failure.
    pub failure: u64,
    /// Labelled unknown.
    pub unknown: u64,
}

/// What one step of a task holds, as models take it.
pub fn shape(spec: &TaskSpec) -> TaskShape {
    let camera = |camera: &gleaner_recording::CameraSpec| CameraShape {
        name: camera.name.clone(),
        height: camera.height,
        width: camera.width,
        depth: camera.depth,
    };
    TaskShape {
        cameras: spec.cameras.iter().map(camera).collect(),
        proprioception: spec.proprioception_size(),
        action: spec.action_size(),
    }
}
