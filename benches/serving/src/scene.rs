//! The scene: a task with two 128 × 128 colour cameras, and steps with shapes and noise, so that JPEG takes as long as on a
//! real picture.

use gleaner_client::observation;
use gleaner_proto::v1::{CameraFrame, Image, ImageFormat, Observation};
use gleaner_recording::{Alignment, CameraSpec, FieldSpec, TaskSpec, encode_jpeg, written_mapping};

use crate::Result;

/// The side of an image in pixels.
pub const SIDE: u32 = 128;
const CAMERAS: [&str; 2] = ["top", "hand"];
const PROPRIOCEPTION: u32 = 38;
const ACTION: u32 = 7;
const JPEG_QUALITY: u8 = 90;

/// One step.
#[derive(Clone)]
pub struct Step {
    /// RGB of each camera, one after the other.
    pub frames: Vec<u8>,
    pub proprioception: Vec<f32>,
    pub action: Vec<f32>,
}

/// The format of sent images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Images {
    Raw,
    Jpeg,
}

/// The task.
pub fn task() -> TaskSpec {
    let camera =
        |name: &str| CameraSpec { name: name.to_owned(), height: SIDE, width: SIDE, depth: false, recorded: None };
    let mut spec = TaskSpec {
        name: "serving".to_owned(),
        instruction: String::new(),
        openpi: Vec::new(),
        rate_hz: 20.0,
        cameras: CAMERAS.map(camera).to_vec(),
        proprioception: vec![FieldSpec::new("state", PROPRIOCEPTION)],
        action: vec![FieldSpec::new("command", ACTION)],
        alignment: Alignment::LatestBefore,
        tolerance: 0.25,
        mappings: Vec::new(),
    };
    spec.mappings = vec![written_mapping(&spec)];
    spec
}

/// The steps of an episode, which the seed determines.
pub fn steps(seed: u64, count: usize) -> Vec<Step> {
    let mut random = Random(seed * 2 + 1);
    (0..count).map(|step| one(&mut random, step)).collect()
}

fn one(random: &mut Random, step: usize) -> Step {
    let mut frames = Vec::new();
    for camera in 0..CAMERAS.len() {
        let bright = 40 * (camera + 1);
        for place in 0..(SIDE * SIDE) as usize {
            let (y, x) = (place / SIDE as usize, place % SIDE as usize);
            // A gradient, a square that moves, and noise.
            let inside = (x + 3 * step) % 128 < 40 && (30..70).contains(&y);
            for colour in 0..3 {
                let base = bright + x / 2 + y / (colour + 2) + if inside { 60 - 20 * colour } else { 0 };
                frames.push(u8::try_from(base.min(235)).unwrap_or(235) + random.byte() % 16);
            }
        }
    }
    let mut values = |count: u32| (0..count).map(|_| f32::from(random.byte()) / 128.0 - 1.0).collect::<Vec<f32>>();
    Step { frames, proprioception: values(PROPRIOCEPTION), action: values(ACTION) }
}

/// A step as an observation.
pub fn observe(spec: &TaskSpec, step: &Step, images: Images) -> Result<Observation> {
    if images == Images::Raw {
        return Ok(observation(spec, 0, step.frames.clone(), step.proprioception.clone())?);
    }
    let pixels = step.frames.chunks(step.frames.len() / CAMERAS.len());
    let frame = |(camera, rgb): (&&str, &[u8])| {
        let data = encode_jpeg(rgb, SIDE, SIDE, JPEG_QUALITY)?.into();
        let color = Some(Image { format: ImageFormat::Jpeg.into(), data });
        Ok(CameraFrame { camera: (*camera).to_owned(), color, depth: None })
    };
    let cameras = CAMERAS.iter().zip(pixels).map(frame).collect::<Result<_>>()?;
    Ok(Observation { cameras, proprioception: step.proprioception.clone(), ..Observation::default() })
}

/// Reproducible random numbers.
struct Random(u64);

impl Random {
    fn byte(&mut self) -> u8 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        self.0.to_be_bytes()[0]
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn steps_fit_their_task_and_differ() {
        let (spec, made) = (task(), steps(3, 3));
        gleaner_recording::validate(&spec).unwrap();
        assert_eq!(made[0].frames.len(), gleaner_recording::frame_bytes_per_step(&spec));
        assert_ne!(made[0].frames, made[1].frames);
        assert_ne!(steps(4, 1)[0].frames, made[0].frames);
        let jpeg = observe(&spec, &made[0], Images::Jpeg).unwrap();
        assert!(jpeg.cameras.iter().all(|camera| camera.color.as_ref().unwrap().data.len() > 2000));
    }
}
