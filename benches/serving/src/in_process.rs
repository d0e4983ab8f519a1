//! The model alone, in this process, on the same checkpoint: the cost of a request without serving. JPEG images are decoded
//! here too.

use std::time::{Duration, Instant};

use gleaner_learn::{History, Policy, set_threads};
use gleaner_proto::v1::Observation;
use gleaner_recording::{PictureSizes, PixelFormat, decode_color};

use crate::Result;
use crate::load::{quantile, times};
use crate::prepare::Prepared;
use crate::scene::{Images, SIDE, Step};

/// A policy and one session's history.
pub struct InProcess {
    policy: Policy,
    history: History,
    taken: Vec<Duration>,
}

impl InProcess {
    /// Loads the policy with one thread for its tensors, like the server.
    pub fn load(prepared: &Prepared) -> Result<Self> {
        set_threads(1);
        let policy = Policy::load(&prepared.checkpoint)?;
        let history = History::new(policy.segment_length());
        Ok(Self { policy, history, taken: Vec::new() })
    }

    /// Runs `steps`, whose observations are `scene`, for `slice` after a warm-up of a quarter of it.
    pub fn add(&mut self, steps: &[Step], (images, scene): (Images, &[Observation]), slice: Duration) -> Result<()> {
        let from = Instant::now() + slice / 4;
        for (step, observation) in steps.iter().zip(scene).cycle() {
            let begun = Instant::now();
            if begun >= from + slice {
                break;
            }
            match images {
                Images::Raw => self.reply(step, &step.frames)?,
                Images::Jpeg => self.reply(step, &decode(observation)?)?,
            }
            if begun >= from {
                self.taken.push(begun.elapsed());
            }
        }
        Ok(())
    }

    /// The median time of the requests since the last call, in milliseconds.
    pub fn take_median(&mut self) -> f64 {
        quantile(&times(std::mem::take(&mut self.taken).into_iter()), 0.5)
    }

    /// One request: its frame is encoded, then one pass over the history.
    fn reply(&mut self, step: &Step, frames: &[u8]) -> Result<()> {
        let embedding = self.policy.embed(&[frames])?.pop().ok_or("no embedding")?;
        self.history.push(embedding, step.proprioception.clone())?;
        let action = self.policy.act(&[&self.history])?.pop().and_then(|chunk| chunk.into_iter().next());
        Ok(self.history.set_executed(action.ok_or("no action")?)?)
    }
}

/// The pixels of both cameras.
fn decode(observation: &Observation) -> Result<Vec<u8>> {
    let mut pixels = Vec::new();
    for image in observation.cameras.iter().filter_map(|camera| camera.color.as_ref()) {
        pixels.extend(decode_color(&image.data, PixelFormat::Jpeg, &PictureSizes::new(SIDE, SIDE))?);
    }
    Ok(pixels)
}
