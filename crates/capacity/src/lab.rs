//! A lab: its robots, what they record, and for how long it is kept.

use serde::Serialize;

use crate::camera::Camera;

/// Seconds of an hour.
const HOUR: f64 = 3600.0;

/// A lab that records every day.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Lab {
    /// Robots that record and are served.
    pub robots: u32,
    /// Hours that each of them records in a day.
    pub hours_a_day: f64,
    /// Seconds of one episode.
    pub episode_seconds: f64,
    /// Steps a second, at which robots record and ask for actions.
    pub rate: f64,
    /// The cameras of each robot.
    pub cameras: Vec<Camera>,
    /// Height and width of a picture at the size of learning, in pixels.
    pub learned_pixels: u32,
    /// Expert episodes of one score run, with which every segment is compared.
    pub experts: u32,
    /// Days whose recordings one score run or training reads.
    pub run_days: u32,
    /// Days for which recordings are kept.
    pub days: u32,
}

impl Lab {
    /// Steps that all robots record in a day.
    #[must_use]
    pub fn steps_a_day(&self) -> f64 {
        f64::from(self.robots) * self.hours_a_day * HOUR * self.rate
    }

    /// Episodes that all robots record in a day.
    #[must_use]
    pub fn episodes_a_day(&self) -> f64 {
        f64::from(self.robots) * self.hours_a_day * HOUR / self.episode_seconds
    }

    /// Bytes that one robot records in a second.
    #[must_use]
    pub fn bytes_a_second(&self) -> f64 {
        self.rate * self.recorded_bytes_a_step()
    }

    /// Bytes that one robot records at one step.
    pub(crate) fn recorded_bytes_a_step(&self) -> f64 {
        self.cameras.iter().map(Camera::recorded_bytes).sum()
    }

    /// Bytes of all recordings that are kept.
    #[must_use]
    pub fn recorded_bytes(&self) -> f64 {
        self.steps() * self.recorded_bytes_a_step()
    }

    /// Bytes that all robots record in a day.
    #[must_use]
    pub fn bytes_a_day(&self) -> f64 {
        f64::from(self.robots) * self.hours_a_day * HOUR * self.bytes_a_second()
    }

    /// Episodes that are kept.
    #[must_use]
    pub fn episodes(&self) -> f64 {
        self.episodes_a_day() * f64::from(self.days)
    }

    /// Steps that are kept.
    #[must_use]
    pub fn steps(&self) -> f64 {
        self.steps_a_day() * f64::from(self.days)
    }

    /// Episodes that one score run or training reads.
    #[must_use]
    pub fn run_episodes(&self) -> f64 {
        self.episodes_a_day() * f64::from(self.run_days.min(self.days))
    }

    /// Segments of one score run, one for each step.
    #[must_use]
    pub fn run_segments(&self) -> f64 {
        self.steps_a_day() * f64::from(self.run_days.min(self.days))
    }

    pub(crate) fn camera_count(&self) -> f64 {
        self.cameras.iter().map(|camera| f64::from(camera.count)).sum()
    }
}
