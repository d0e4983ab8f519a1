//! The interface of a scorer's thread to its model: `learn`'s live scorer, or test doubles.

use bytes::Bytes;
use gleaner_learn::{EpisodeScores, History, LearnError, LiveScorer, SegmentScore, TaskShape, Trajectory};

use crate::error::{Error, Result};

/// One step of a running episode, with its executed action.
#[derive(Debug, Clone)]
pub(crate) struct Step {
    /// The stamp of the observation.
    pub(crate) stamp_ns: i64,
    /// Images in the model's layout.
    pub(crate) frames: Bytes,
    /// In physical units.
    pub(crate) proprioception: Vec<f32>,
    /// In physical units.
    pub(crate) action: Vec<f32>,
    /// Does not continue the previous step: a new history begins.
    pub(crate) begins: bool,
    /// Whether the segment that ends here is whole and so gets a score.
    pub(crate) scored: bool,
}

/// Steps that continue a history.
#[derive(Debug)]
pub(crate) struct Stretch<H> {
    /// `None` begins a new history.
    pub(crate) history: Option<H>,
    /// Oldest first.
    pub(crate) steps: Vec<Step>,
}

/// The output for a stretch.
#[derive(Debug)]
pub(crate) struct Followed<H> {
    /// The history with the stretch's steps.
    pub(crate) history: Option<H>,
    /// One for each step to be scored.
    pub(crate) scores: Vec<SegmentScore>,
}

/// A scorer as seen by its thread. Stretches are passed by reference, so that a failed batch can be run again one at a
/// time.
pub(crate) trait Scorer: 'static {
    /// The scorer's state per episode.
    type History: Send + 'static;

    /// The shape of a step.
    fn shape(&self) -> &TaskShape;

    /// The steps of a whole segment: l + 1.
    fn window(&self) -> usize;

    /// Scores every stretch, in order.
    ///
    /// # Errors
    /// Invalid when a step does not fit the task; Internal.
    fn follow(&self, stretches: &[&Stretch<Self::History>]) -> Result<Vec<Followed<Self::History>>>;

    /// The scores of a whole episode.
    ///
    /// # Errors
    /// Invalid when it does not fit the task; Internal.
    fn episode(&self, episode: &Trajectory) -> Result<EpisodeScores>;
}

impl Scorer for LiveScorer {
    type History = History;

    fn shape(&self) -> &TaskShape {
        self.shape()
    }

    fn window(&self) -> usize {
        usize::try_from(self.segment_length()).unwrap_or(usize::MAX).saturating_add(1)
    }

    fn follow(&self, stretches: &[&Stretch<History>]) -> Result<Vec<Followed<History>>> {
        let learned = |error: LearnError| error.during("scoring");
        let frames: Vec<&[u8]> =
            stretches.iter().flat_map(|stretch| &stretch.steps).map(|step| &step.frames[..]).collect();
        let mut embeddings = self.embed(&frames).map_err(learned)?.into_iter();
        let (mut histories, mut moments) = (Vec::with_capacity(stretches.len()), Vec::new());
        for stretch in stretches {
            let mut history = stretch.history.clone();
            let before = moments.len();
            for step in &stretch.steps {
                let going_on = history.take().filter(|_| !step.begins);
                let mut now = going_on.unwrap_or_else(|| History::new(self.segment_length()));
                let embedding = embeddings
                    .next()
                    .ok_or_else(|| Error::internal("embedding frames", "fewer embeddings than frames"))?;
                now.push(embedding, step.proprioception.clone()).map_err(learned)?;
                now.set_executed(step.action.clone()).map_err(learned)?;
                if step.scored {
                    moments.push(now.clone());
                }
                history = Some(now);
            }
            histories.push((history, moments.len() - before));
        }
        let mut scores = self.score(&moments.iter().collect::<Vec<_>>()).map_err(learned)?.into_iter();
        let followed = histories.into_iter();
        Ok(followed
            .map(|(history, count)| Followed { history, scores: scores.by_ref().take(count).collect() })
            .collect())
    }

    fn episode(&self, episode: &Trajectory) -> Result<EpisodeScores> {
        self.score_episode(episode).map_err(|error| error.during("scoring"))
    }
}
