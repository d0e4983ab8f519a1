//! Single steps of an episode: the selected image, and the values of every step.

/// The selected image of an episode.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameView {
    /// The step, from 0.
    pub step: u64,
    /// The camera's name in the task.
    pub camera: String,
    /// Its depth image instead of colour: from near (light) to far (dark), scaled to this frame; black without a
    /// reading.
    pub depth: bool,
    /// The most pixels in width and height; `None` as recorded. Images are only scaled down.
    pub size: Option<u32>,
}

/// The values of every step, by the task's field names.
#[derive(Debug, Clone, PartialEq)]
pub struct Numbers {
    /// The time of each step, in nanoseconds.
    pub stamps_ns: Vec<i64>,
    /// The proprioception, field by field.
    pub proprioception: Vec<Series>,
    /// The action, field by field.
    pub action: Vec<Series>,
}

/// One field over an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// The field's name.
    pub name: String,
    /// The number of values at each step.
    pub size: usize,
    /// T × size values, step after step.
    pub values: Vec<f32>,
}
