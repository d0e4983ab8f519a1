//! The pieces of a dataset: experts whole, and each run of kept steps of an imperfect episode.

use std::ops::Range;
use std::sync::Arc;

use gleaner_core::dataset::KeptSegment;
use gleaner_core::snapshot::Role;
use gleaner_core::work::{InputEpisode, KeptInput};
use gleaner_recording::StepScore;

use crate::problem::Problem;

/// Consecutive steps of one episode that are one file, or one episode of a format that has several in a file.
#[derive(Clone, Debug)]
pub struct Piece {
    source: Source,
    /// Its steps, by their numbers in the original episode.
    pub steps: Range<usize>,
}

#[derive(Clone, Debug)]
enum Source {
    Expert(InputEpisode),
    Kept(Arc<KeptInput>),
}

/// Every piece: the experts, then the stretches of the kept episodes, in their order, or those episodes `whole`.
///
/// # Errors
/// [`Problem::Input`] if an episode has no scores of its kept steps.
pub fn pieces(experts: Vec<InputEpisode>, kept: Vec<KeptInput>, whole: bool) -> Result<Vec<Piece>, Problem> {
    let mut pieces = Vec::with_capacity(experts.len() + kept.len());
    let all = |episode: &InputEpisode| {
        let steps = usize::try_from(episode.steps).map_err(|_| Problem::Input("an episode is too long".to_owned()));
        steps.map(|steps| 0..steps)
    };
    for expert in experts {
        let steps = all(&expert)?;
        pieces.push(Piece { source: Source::Expert(expert), steps });
    }
    for kept in kept.into_iter().map(Arc::new) {
        let of_stretches =
            || stretches(&kept.segments).into_iter().map(|run| file_steps(&kept.segments[run], &kept.qualities));
        let found = if whole { vec![Some(all(&kept.episode)?)] } else { of_stretches().collect() };
        for steps in found {
            let steps = steps.filter(|steps| steps.end <= kept.qualities.len().min(kept.similarities.len()));
            let missing = || Problem::Input(format!("the kept steps of {} have no scores", kept.episode.id));
            pieces.push(Piece { source: Source::Kept(Arc::clone(&kept)), steps: steps.ok_or_else(missing)? });
        }
    }
    Ok(pieces)
}

impl Piece {
    /// The episode.
    pub fn episode(&self) -> &InputEpisode {
        match &self.source {
            Source::Expert(episode) => episode,
            Source::Kept(kept) => &kept.episode,
        }
    }

    /// Its role in the dataset's snapshot.
    pub fn role(&self) -> Role {
        match &self.source {
            Source::Expert(_) => Role::Expert,
            Source::Kept(_) => Role::Imperfect,
        }
    }

    /// Whether a step of it is kept.
    pub fn is_kept(&self) -> bool {
        match &self.source {
            Source::Expert(_) => true,
            Source::Kept(kept) => !kept.segments.is_empty(),
        }
    }

    /// Number of steps.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether it has no steps, which a piece of an accepted recording never is.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Whether it is the whole episode.
    pub fn is_whole(&self) -> bool {
        self.steps.start == 0 && u64::try_from(self.steps.end) == Ok(self.episode().steps)
    }

    /// A name for a file, without an ending: the episode's id and, of a part of it, its first and last step.
    pub fn name(&self) -> String {
        let id = &self.episode().id;
        match self.is_whole() {
            true => id.to_string(),
            false => format!("{id}_{}-{}", self.steps.start, self.steps.end.saturating_sub(1)),
        }
    }

    /// What the score run states of each step. Experts are kept with q = 1; they have no w, which is 0 here.
    pub fn scores(&self) -> Vec<StepScore> {
        match &self.source {
            Source::Expert(_) => {
                self.steps.clone().map(|_| StepScore { q: 1.0, kept: true, ..StepScore::default() }).collect()
            }
            Source::Kept(kept) => self.steps.clone().map(|step| score(kept, step)).collect(),
        }
    }
}

/// The score of a step, which was checked to have one.
fn score(kept: &KeptInput, step: usize) -> StepScore {
    let segment = u32::try_from(step).ok().and_then(|step| {
        let at = kept.segments.binary_search_by_key(&step, |segment| segment.end_step).ok()?;
        kept.segments.get(at)
    });
    let nearest = segment.and_then(|segment| segment.nearest.as_ref());
    StepScore {
        q: kept.qualities.get(step).copied().unwrap_or_default(),
        w: kept.similarities.get(step).copied().unwrap_or_default(),
        kept: segment.is_some(),
        matched: nearest.map(|nearest| (nearest.episode_id.to_string(), nearest.end_step)),
    }
}

/// Runs of segments with consecutive end steps.
fn stretches(segments: &[KeptSegment]) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (at, segment) in segments.iter().enumerate() {
        let follows = at > 0 && segments[at - 1].end_step + 1 == segment.end_step;
        match runs.last_mut() {
            Some(run) if follows => run.end = at + 1,
            Some(_) | None => runs.push(at..at + 1),
        }
    }
    runs
}

/// The steps of a stretch: its own. A single step does not make a recording, so the neighbour with the higher quality is
/// added; scores mark which step was kept.
fn file_steps(segments: &[KeptSegment], qualities: &[f32]) -> Option<Range<usize>> {
    let step = |segment: &KeptSegment| usize::try_from(segment.end_step).ok();
    let (first, last) = (step(segments.first()?)?, step(segments.last()?)?);
    if first < last {
        return Some(first..last + 1);
    }
    let before = first.checked_sub(1).and_then(|before| qualities.get(before));
    match (before, qualities.get(first + 1)) {
        (Some(before), Some(after)) if after > before => Some(first..first + 2),
        (Some(_), _) => Some(first - 1..first + 1),
        (None, Some(_)) => Some(first..first + 2),
        (None, None) => Some(first..first + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(steps: &[u32]) -> Vec<KeptSegment> {
        let segment = |&end_step: &u32| KeptSegment { end_step, weight: 1.0, nearest: None };
        steps.iter().map(segment).collect()
    }

    #[test]
    fn consecutive_steps_are_one_stretch() {
        assert_eq!(stretches(&kept(&[0, 1, 2, 5, 6, 9])), [0..3, 3..5, 5..6]);
        assert_eq!(stretches(&kept(&[7, 9])), [0..1, 1..2]);
        assert!(stretches(&[]).is_empty());
    }

    #[test]
    fn a_single_step_is_exported_with_its_better_neighbour() {
        let q = [0.9, 0.1, 0.9, 0.3, 0.9];
        assert_eq!(file_steps(&kept(&[1, 2, 3]), &q), Some(1..4));
        assert_eq!(file_steps(&kept(&[0]), &q), Some(0..2));
        assert_eq!(file_steps(&kept(&[2]), &q), Some(2..4));
        assert_eq!(file_steps(&kept(&[4]), &q), Some(3..5));
        assert_eq!(file_steps(&kept(&[0]), &q[..1]), Some(0..1));
        assert_eq!(file_steps(&[], &q), None);
    }

    #[test]
    fn kept_steps_without_scores_are_refused_by_episode() {
        let kept = crate::testing::kept_input(8, &[(5, 0.9)]);
        let id = kept.episode.id.clone();
        let cut = KeptInput { qualities: vec![0.5; 3], ..kept };
        for whole in [false, true] {
            assert!(pieces(Vec::new(), vec![cut.clone()], whole).unwrap_err().to_string().contains(id.as_str()));
        }
    }

    #[test]
    fn a_whole_episode_is_one_piece_that_marks_its_kept_steps() {
        let kept = crate::testing::kept_input(5, &[(1, 0.9), (3, 0.8)]);
        let none = KeptInput { segments: Vec::new(), ..crate::testing::kept_input(4, &[]) };
        let pieces = pieces(Vec::new(), vec![kept.clone(), none], true).unwrap();
        assert_eq!(pieces.iter().map(|piece| piece.steps.clone()).collect::<Vec<_>>(), [0..5, 0..4]);
        assert_eq!(pieces[0].name(), kept.episode.id.as_str());
        let marks = |piece: &Piece| piece.scores().iter().map(|score| score.kept).collect::<Vec<_>>();
        assert_eq!(marks(&pieces[0]), [false, true, false, true, false]);
        assert_eq!(marks(&pieces[1]), [false; 4]);
        let q: Vec<f32> = pieces[0].scores().iter().map(|score| score.q).collect();
        assert_eq!(q, kept.qualities);
    }
}
