//! Features that can be compared, and the scores of an episode by its matches. Independent of the search.

use gleaner_core::snapshot::Role;
use gleaner_search::Match;

use super::EpisodeScores;
use super::features::Features;
use crate::error::LearnError;

/// The features of episode `of`; fails unless they can be compared.
pub(super) fn sound(features: Features, of: &str) -> Result<Features, LearnError> {
    if features.comparable() {
        return Ok(features);
    }
    let message = format!("gives features of episode {of} that are not finite; train the encoder again");
    Err(LearnError::Checkpoint(message))
}

/// The scores of an episode by its matches, without q. `places` has the index of every expert in the given order.
pub(super) fn described((id, role): (&str, Role), places: &[u32], matches: &[Match]) -> EpisodeScores {
    EpisodeScores {
        episode_id: id.to_owned(),
        role,
        w: matches.iter().map(w_of).collect(),
        q: Vec::new(),
        match_episode: matches.iter().map(|found| places[found.group as usize]).collect(),
        match_step: matches.iter().map(|found| found.row).collect(),
        distances: matches.iter().map(|found| found.parts).collect(),
    }
}

/// w of a match. Not −distance, which would make −0 of the best w.
pub(super) fn w_of(found: &Match) -> f64 {
    0.0 - found.distance
}
