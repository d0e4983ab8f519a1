//! stub
#![allow(missing_docs)]
use crate::error::LearnError;
use crate::spec::ScoreSpec;
use crate::train::Monitor;
use crate::trajectory::Trajectory;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Normaliser {
    pub lo: f64,
    pub hi: f64,
}
impl Normaliser {
    pub fn q(&self, w: f64) -> f32 {
        let _ = w;
        0.0
    }
}

/// The scores of one episode's segments; index t is the segment that ends at step t.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeScores {
    /// The episode's id.
    pub id: String,
    /// Similarity to the nearest expert segment.
    pub w: Vec<f64>,
    /// Quality in 0 … 1.
    pub q: Vec<f32>,
    /// The nearest expert segment's episode: index into the experts.
    pub match_episode: Vec<u32>,
    /// The step the nearest expert segment ends at.
    pub match_step: Vec<u32>,
    /// Unscaled distances of o, m and a to it.
    pub distances: Vec<[f32; 3]>,
}
/// What a score run found.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// One entry per imperfect episode, in the order given.
    pub imperfect: Vec<EpisodeScores>,
    /// Leave-one-episode-out scores of the experts; empty if there is only one expert.
    pub experts: Vec<EpisodeScores>,
    /// Similarity that becomes quality 0.
    pub lo: f64,
    /// Similarity that becomes quality 1.
    pub hi: f64,
}
pub fn score(
    _encoder: &[u8],
    _experts: &[Trajectory],
    _imperfect: &[Trajectory],
    _spec: &ScoreSpec,
    _monitor: &mut dyn Monitor,
) -> Result<Scores, LearnError> {
    Err(LearnError::Torch("not built yet".into()))
}
