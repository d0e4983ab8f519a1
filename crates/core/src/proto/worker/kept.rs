//! The kept steps of a job's episodes. The nearest expert of each is a number, because there may be millions of them.

use std::collections::HashMap;

use gleaner_proto::v1;

use super::{episode_from, episode_to, field};
use crate::{
    dataset::{KeptSegment, Nearest},
    error::{Error, Result},
    id::EpisodeId,
    work::KeptInput,
};

/// The kept steps, and the experts that their numbers count from 1.
pub(super) fn to(kept: Vec<KeptInput>) -> (Vec<v1::KeptSegments>, Vec<String>) {
    let mut experts = Experts::default();
    let kept = kept.into_iter().map(|kept| segments_to(kept, &mut experts)).collect();
    (kept, experts.ids)
}

/// Reads kept steps and the experts that their numbers refer to.
///
/// # Errors
/// Invalid when the server speaks another version.
pub(super) fn from(kept: Vec<v1::KeptSegments>, experts: Vec<String>) -> Result<Vec<KeptInput>> {
    let experts =
        experts.into_iter().map(|id| EpisodeId::parse("match_episode_ids", &id)).collect::<Result<Vec<_>>>()?;
    kept.into_iter().map(|kept| segments_from(kept, &experts)).collect()
}

/// The experts named before, each with its number.
#[derive(Default)]
struct Experts {
    ids: Vec<String>,
    numbers: HashMap<EpisodeId, u32>,
}

impl Experts {
    fn number(&mut self, id: &EpisodeId) -> u32 {
        if let Some(&number) = self.numbers.get(id) {
            return number;
        }
        self.ids.push(id.to_string());
        // A message has no room for this number of experts.
        let number = u32::try_from(self.ids.len()).unwrap_or(u32::MAX);
        self.numbers.insert(id.clone(), number);
        number
    }
}

fn segments_to(kept: KeptInput, experts: &mut Experts) -> v1::KeptSegments {
    let KeptInput { episode, segments, similarities, qualities } = kept;
    let matched = segments.iter().any(|segment| segment.nearest.is_some());
    let (match_steps, match_episodes) = segments
        .iter()
        .filter(|_| matched)
        .map(|segment| match &segment.nearest {
            Some(Nearest { episode_id, end_step }) => (*end_step, experts.number(episode_id)),
            None => (0, 0),
        })
        .unzip();
    v1::KeptSegments {
        episode: Some(episode_to(episode)),
        end_steps: segments.iter().map(|segment| segment.end_step).collect(),
        weights: segments.iter().map(|segment| segment.weight).collect(),
        match_steps,
        match_episodes,
        similarities,
        qualities,
    }
}

fn segments_from(kept: v1::KeptSegments, experts: &[EpisodeId]) -> Result<KeptInput> {
    let v1::KeptSegments { episode, end_steps, weights, match_steps, match_episodes, similarities, qualities } = kept;
    let matches = match_steps.len();
    if weights.len() != end_steps.len()
        || match_episodes.len() != matches
        || ![0, end_steps.len()].contains(&matches)
        || similarities.len() != qualities.len()
    {
        return Err(Error::invalid("kept", "its lists must have the same length"));
    }
    let mut matches = match_steps.into_iter().zip(match_episodes);
    let segments = end_steps.into_iter().zip(weights).map(|(end_step, weight)| {
        let nearest = match matches.next() {
            None | Some((_, 0)) => None,
            Some((step, number)) => {
                let expert = usize::try_from(number).ok().and_then(|number| experts.get(number - 1));
                let unknown = || Error::invalid("kept.match_episodes", "is out of the range of match_episode_ids");
                Some(Nearest { episode_id: expert.ok_or_else(unknown)?.clone(), end_step: step })
            }
        };
        Ok(KeptSegment { end_step, weight, nearest })
    });
    let segments = segments.collect::<Result<_>>()?;
    Ok(KeptInput {
        episode: episode_from(field::required("kept.episode", episode)?)?,
        segments,
        similarities,
        qualities,
    })
}
