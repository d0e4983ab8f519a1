//! The features of a dataset: names, types and shapes, as `meta/info.json` declares them.

use gleaner_core::dataset::ExportSpec;
use gleaner_core::{FieldSpec, TaskSpec};
use gleaner_recording::{RecordingError, encode_depth_png, encode_png};
use serde_json::{Map, Value, json};

/// The number columns that every dataset has, with their types: what gleaner knows of a step, then what LeRobot needs.
pub(super) const COLUMNS: [(&str, &str); 13] = [
    ("next.done", "bool"),
    ("next.success", "bool"),
    ("gleaner.q", "float32"),
    ("gleaner.w", "float32"),
    ("gleaner.weight", "float32"),
    ("gleaner.match_episode", "int64"),
    ("gleaner.match_step", "int64"),
    ("gleaner.step", "int64"),
    ("timestamp", "float32"),
    ("frame_index", "int64"),
    ("episode_index", "int64"),
    ("index", "int64"),
    ("task_index", "int64"),
];

/// The numbers of the robot, one list a step.
#[derive(Clone, Debug)]
pub(super) struct Vector {
    pub(super) name: &'static str,
    pub(super) size: usize,
}

/// The pictures of one camera, or its depth.
#[derive(Clone, Debug)]
pub(super) struct Camera {
    pub(super) name: String,
    /// Its place in the task.
    pub(super) camera: usize,
    pub(super) depth: bool,
    pub(super) height: u32,
    pub(super) width: u32,
    /// Whether its pictures are a video rather than images in the tables.
    pub(super) film: bool,
    /// Where its pixels are in the frames of a step.
    offset: usize,
}

/// The features of a dataset of one task.
#[derive(Clone, Debug)]
pub(super) struct Features {
    fps: u32,
    vectors: Vec<Vector>,
    cameras: Vec<Camera>,
    sizes: (usize, usize),
}

impl Features {
    pub(super) fn new(task: &TaskSpec, spec: ExportSpec) -> Self {
        let (mut cameras, mut offset) = (Vec::new(), 0);
        for (camera, of) in task.cameras.iter().enumerate() {
            for (of_depth, pixel_bytes, ending) in [(false, 3, ""), (true, 2, "_depth")] {
                if of_depth && !of.depth {
                    continue;
                }
                let name = format!("observation.images.{}{ending}", of.name);
                if !of_depth || spec.depth {
                    let (height, width) = (of.height, of.width);
                    let film = spec.video && !of_depth;
                    cameras.push(Camera { name, camera, depth: of_depth, height, width, film, offset });
                }
                offset += of.height as usize * of.width as usize * pixel_bytes;
            }
        }
        let sizes = (task.proprioception_size(), task.action_size());
        let vectors = [("observation.state", sizes.0), ("action", sizes.1)];
        let vectors = vectors.into_iter().filter(|(_, size)| *size > 0).map(|(name, size)| Vector { name, size });
        Self { fps: fps(task.rate_hz), vectors: vectors.collect(), cameras, sizes }
    }

    /// Steps a second, which the format holds as an integer.
    pub(super) fn fps(&self) -> u32 {
        self.fps
    }

    #[expect(clippy::cast_precision_loss, reason = "rates are small")]
    pub(super) fn fps_f32(&self) -> f32 {
        self.fps as f32
    }

    pub(super) fn state_size(&self) -> usize {
        self.sizes.0
    }

    pub(super) fn action_size(&self) -> usize {
        self.sizes.1
    }

    pub(super) fn vectors(&self) -> &[Vector] {
        &self.vectors
    }

    pub(super) fn cameras(&self) -> &[Camera] {
        &self.cameras
    }

    /// Cameras whose pictures are images in the tables.
    pub(super) fn stored(&self) -> impl Iterator<Item = &Camera> {
        self.cameras.iter().filter(|camera| !camera.film)
    }

    /// Whether pictures are videos.
    pub(super) fn is_filmed(&self) -> bool {
        self.cameras.iter().any(|camera| camera.film)
    }

    pub(super) fn to_json(&self, task: &TaskSpec) -> Value {
        let mut features = Map::new();
        for (vector, specs) in self
            .vectors
            .iter()
            .map(|vector| (vector, if vector.name == "action" { &task.action } else { &task.proprioception }))
        {
            let names = json!({"dtype": "float32", "shape": [vector.size], "names": names(specs)});
            features.insert(vector.name.to_owned(), names);
        }
        for camera in &self.cameras {
            let channels = if camera.depth { 1 } else { 3 };
            let mut feature = json!({
                "dtype": if camera.film { "video" } else { "image" }, "shape": [camera.height, camera.width, channels],
                "names": ["height", "width", "channels"],
            });
            if camera.depth {
                feature["info"] = json!({"is_depth_map": true, "depth_unit": "mm"});
            }
            if camera.film {
                feature["info"] = json!({
                    "video.height": camera.height, "video.width": camera.width, "video.channels": 3,
                    "video.codec": "av1", "video.pix_fmt": "yuv420p", "video.fps": self.fps,
                    "video.is_depth_map": false, "has_audio": false,
                });
            }
            features.insert(camera.name.clone(), feature);
        }
        for (name, dtype) in COLUMNS {
            features.insert(name.to_owned(), json!({"dtype": dtype, "shape": [1], "names": Value::Null}));
        }
        Value::Object(features)
    }
}

impl Camera {
    /// Its pixels in the frames of a step.
    pub(super) fn pixels<'a>(&self, frames: &'a [u8]) -> &'a [u8] {
        let bytes = self.height as usize * self.width as usize * if self.depth { 2 } else { 3 };
        frames.get(self.offset..self.offset + bytes).unwrap_or_default()
    }

    /// Its picture of a step without loss.
    pub(super) fn png(&self, frames: &[u8]) -> Result<Vec<u8>, RecordingError> {
        let encode = if self.depth { encode_depth_png } else { encode_png };
        encode(self.pixels(frames), self.height, self.width)
    }
}

/// A name for each number: the field's, and its place in it if it has several.
fn names(specs: &[FieldSpec]) -> Vec<String> {
    let of = |spec: &FieldSpec| match spec.size {
        1 => vec![spec.name.clone()],
        size => (0..size).map(|at| format!("{}.{at}", spec.name)).collect(),
    };
    specs.iter().flat_map(of).collect()
}

fn fps(rate_hz: f64) -> u32 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the range is limited first")]
    let fps = rate_hz.round().clamp(1.0, 1e6) as u32;
    fps
}
