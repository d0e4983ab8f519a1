//! The earlier run that a run extends: its checks, and its matches in the numbering of the new run.

use std::collections::{HashMap, HashSet};

use gleaner_core::snapshot::Role;
use gleaner_search::Match;

use super::{EpisodeScores, ScoreBase};
use crate::error::LearnError;
use crate::trajectory::Trajectory;

/// The scores that exist before the search begins.
#[derive(Default)]
pub(super) struct Known<'a> {
    scores: HashMap<&'a str, &'a EpisodeScores>,
    /// The new number, and the number of steps, of every expert of the earlier run.
    experts: Vec<(u32, usize)>,
}

impl<'a> Known<'a> {
    /// The scores of `base`, for `experts` in the order of their numbers and the `imperfect`.
    pub(super) fn new(
        base: &'a ScoreBase,
        experts: &[&Trajectory],
        imperfect: &[Trajectory],
    ) -> Result<Self, LearnError> {
        base.normaliser.validate("base.normaliser")?;
        let number = |id: &String| {
            let at = experts.iter().position(|expert| expert.id == *id).ok_or_else(|| {
                let message = format!("has {id}, which is not among the experts; add it, or score without extends");
                LearnError::invalid("base.experts", message)
            })?;
            Ok((u32::try_from(at).unwrap_or(u32::MAX), experts[at].steps()))
        };
        let known = Self {
            scores: base.scores.iter().map(|scores| (scores.episode_id.as_str(), scores)).collect(),
            experts: base.experts.iter().map(number).collect::<Result<_, LearnError>>()?,
        };
        for episode in experts.iter().copied().chain(imperfect) {
            known.check(episode)?;
        }
        Ok(known)
    }

    /// The numbers of the earlier run's experts.
    pub(super) fn had(&self) -> HashSet<u32> {
        self.experts.iter().map(|(number, _)| *number).collect()
    }

    /// The matches of episode `id` among the earlier run's experts; `None` if it had no scores.
    pub(super) fn matches(&self, id: &str) -> Option<Vec<Option<Match>>> {
        let scores = self.scores.get(id)?;
        let known = |step: usize| {
            let (number, _) = self.experts[scores.match_episode[step] as usize];
            let (row, parts) = (scores.match_step[step], scores.distances[step]);
            Some(Match { group: number, row, distance: -scores.w[step], parts })
        };
        Some((0..scores.w.len()).map(known).collect())
    }

    /// As [`Self::matches`]; `None` also for an episode that was not an expert.
    pub(super) fn matches_of_expert(&self, id: &str) -> Option<Vec<Option<Match>>> {
        self.scores.get(id).filter(|scores| scores.role == Role::Expert).and_then(|_| self.matches(id))
    }

    /// Fails unless the earlier scores of `episode`, if any, fit it.
    fn check(&self, episode: &Trajectory) -> Result<(), LearnError> {
        let Some(scores) = self.scores.get(episode.id.as_str()) else { return Ok(()) };
        let steps = episode.steps();
        let wrong =
            |message: String| Err(LearnError::invalid("base.scores", format!("of episode {} {message}", episode.id)));
        let lengths = [scores.w.len(), scores.match_episode.len(), scores.match_step.len(), scores.distances.len()];
        if lengths.iter().any(|length| *length != steps) {
            return wrong(format!("have lengths {lengths:?}, the episode has {steps} steps; score without extends"));
        }
        if scores.w.iter().any(|w| !(w.is_finite() && *w <= 0.0)) {
            return wrong("hold a w that is not a number at most 0; score without extends".into());
        }
        let mut places = scores.match_episode.iter().zip(&scores.match_step);
        let lost = places.find(|(at, step)| {
            let expert = self.experts.get(**at as usize);
            expert.is_none_or(|(_, steps)| **step as usize >= *steps)
        });
        match lost {
            Some((at, step)) => {
                wrong(format!("match step {step} of expert {at}, which does not exist; score without extends"))
            }
            None => Ok(()),
        }
    }
}
