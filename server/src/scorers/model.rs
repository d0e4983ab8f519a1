//! What a scorer's thread runs, behind a small seam: `learn`'s live scorer, or in tests anything.

use bytes::Bytes;
use gleaner_learn::{EpisodeScores, History, LiveScorer, SegmentScore, TaskShape, Trajectory};

use crate::error::{Error, Result};

/// One step of a running episode, with what was done at it.
#[derive(Debug, Clone)]
pub(crate) struct Step {
    /// Of the observation.
    pub(crate) stamp_ns: i64,
    /// Images as models take them.
    pub(crate) frames: Bytes,
    /// In physical units.
    pub(crate) proprioception: Vec<f32>,
    /// In physical units.
    pub(crate) action: Vec<f32>,
    /// Does not follow the step before: a new history begins.
    pub(crate) begins: bool,
    /// Whether the segment that ends here is whole, so that it has a score.
    pub(crate) scored: bool,
}

/// Steps that go on from a history.
#[derive(Debug)]
pub(crate) struct Stretch<H> {
    /// `None` begins a new one.
    pub(crate) history: Option<H>,
    /// Oldest first.
    pub(crate) steps: Vec<Step>,
}

/// What came of a stretch.
#[derive(Debug)]
pub(crate) struct Followed<H> {
    /// The history with the stretch's steps.
    pub(crate) history: Option<H>,
    /// One for each step that is to be scored.
    pub(crate) scores: Vec<SegmentScore>,
}

/// A scorer as its thread sees it. Stretches go in by reference, so that a failed batch can be run again one by one.
pub(crate) trait Scorer: 'static {
    /// What it remembers of an episode.
    type History: Send + 'static;

    /// What a step must hold.
    fn shape(&self) -> &TaskShape;

    /// Steps of a whole segment: l + 1.
    fn window(&self) -> usize;

    /// Goes on with every stretch, in order.
    ///
    /// # Errors
    /// Invalid when a step does not fit; Internal.
    fn follow(&self, stretches: &[&Stretch<Self::History>]) -> Result<Vec<Followed<Self::History>>>;

    /// The scores of a whole episode.
    ///
    /// # Errors
    /// Invalid when it does not fit; Internal.
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
        let learned = |error| Error::learned("scoring", error);
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
                    .ok_or_else(|| Error::internal("embedding frames", "fewer embeddings came than frames went"))?;
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
        self.score_episode(episode).map_err(|error| Error::learned("scoring", error))
    }
}
