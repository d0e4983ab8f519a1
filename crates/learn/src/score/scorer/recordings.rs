//! The recordings behind experts: episodes with equal steps are one recording, whatever their ids, so that an episode
//! is not judged by its own steps. Independent of scores.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use crate::error::LearnError;
use crate::trajectory::Trajectory;

/// The distinct recordings of some experts, numbered in the order of their ids.
pub(super) struct Recordings<'a> {
    experts: Vec<&'a Trajectory>,
    numbers: HashMap<blake3::Hash, usize>,
}

impl<'a> Recordings<'a> {
    /// The recordings of `experts`, whatever their order.
    pub(super) fn new(experts: impl Iterator<Item = &'a Trajectory>) -> Result<Self, LearnError> {
        let mut sorted: Vec<&Trajectory> = experts.collect();
        sorted.sort_by(|a, b| a.id.cmp(&b.id));
        let mut recordings = Self { experts: Vec::with_capacity(sorted.len()), numbers: HashMap::new() };
        for expert in sorted {
            if let Entry::Vacant(unknown) = recordings.numbers.entry(expert.content()?) {
                unknown.insert(recordings.experts.len());
                recordings.experts.push(expert);
            }
        }
        Ok(recordings)
    }

    /// One expert of each recording, by number.
    pub(super) fn experts(&self) -> &[&'a Trajectory] {
        &self.experts
    }

    /// The number of the recording that has the steps of `episode`; `None` if no expert has them.
    pub(super) fn number(&self, episode: &Trajectory) -> Result<Option<usize>, LearnError> {
        Ok(self.numbers.get(&episode.content()?).copied())
    }
}

/// Fails if an imperfect episode has the id of an expert but other steps.
pub(super) fn check_ids(experts: &[Trajectory], imperfect: &[Trajectory]) -> Result<(), LearnError> {
    let of_ids: HashMap<&str, &Trajectory> = experts.iter().map(|expert| (expert.id.as_str(), expert)).collect();
    for episode in imperfect {
        let Some(expert) = of_ids.get(episode.id.as_str()) else { continue };
        if expert.content()? != episode.content()? {
            let message = "is an expert and imperfect with different steps; give each recording an id of its own";
            return Err(LearnError::invalid(format!("episode {}", episode.id), message));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::toy;

    #[test]
    fn experts_with_equal_steps_are_one_recording_under_any_id() {
        let mut experts = toy::experts(3, 6);
        experts.push(Trajectory { id: "a copy".into(), ..experts[2].clone() });
        let straight = Recordings::new(experts.iter()).unwrap();
        let reversed = Recordings::new(experts.iter().rev()).unwrap();
        for recordings in [&straight, &reversed] {
            let ids: Vec<&str> = recordings.experts().iter().map(|expert| expert.id.as_str()).collect();
            assert_eq!(ids, ["a copy", "expert 0", "expert 1"]);
            assert_eq!([0, 1, 2, 3].map(|at: usize| recordings.number(&experts[at]).unwrap()), [1, 2, 0, 0].map(Some));
            assert_eq!(recordings.number(&toy::episode("expert 0", 9, 6, true)).unwrap(), None);
        }
    }

    #[test]
    fn an_id_with_two_contents_is_rejected() {
        let experts = toy::experts(2, 6);
        assert!(check_ids(&experts, &experts).is_ok());
        let twin = Trajectory { id: experts[1].id.clone(), ..toy::episode("failure", 5, 9, false) };
        let message = check_ids(&experts, &[twin]).unwrap_err().to_string();
        assert!(message.starts_with("episode expert 1: is an expert and imperfect"), "{message}");
    }
}
