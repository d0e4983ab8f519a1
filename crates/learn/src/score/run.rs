//! A score run by nearest expert segments, from the start or as an extension of an earlier run.

use std::time::Instant;

use gleaner_core::snapshot::Role;
use gleaner_search::{Index, Match, Metric};

use super::base::Known;
use super::comparison::Comparison;
use super::features::kept::{self, Kept};
use super::features::{Encoder, FeatureStore, Features, Rough, episode_features, widths};
use super::similarity::metric;
use super::{EpisodeScores, local};
use crate::error::LearnError;
use crate::train::Monitor;
use crate::trajectory::Trajectory;

/// Counts scored segments, reports them to the monitor, and checks for cancellation.
pub(super) struct Progress<'a> {
    monitor: &'a mut dyn Monitor,
    total: u64,
    done: u64,
    begin: Instant,
}

impl<'a> Progress<'a> {
    pub(super) fn new(monitor: &'a mut dyn Monitor, total: u64) -> Self {
        Self { monitor, total, done: 0, begin: Instant::now() }
    }

    pub(super) fn advance(&mut self, segments: usize) -> Result<(), LearnError> {
        if self.monitor.cancelled() {
            return Err(LearnError::Cancelled);
        }
        self.done += segments as u64;
        #[expect(clippy::cast_precision_loss, reason = "a rate for people to read")]
        let rate = self.done as f64 / self.begin.elapsed().as_secs_f64().max(1e-9);
        self.monitor.progress(self.done, self.total, &[("segments_per_second", rate)]);
        Ok(())
    }
}

/// Number of segments of `episodes`.
pub(super) fn count<'a>(episodes: impl IntoIterator<Item = &'a Trajectory>) -> u64 {
    episodes.into_iter().map(|episode| episode.steps() as u64).sum()
}

/// The features of episode `of`; fails unless they can be compared.
pub(super) fn sound(features: Features, of: &str) -> Result<Features, LearnError> {
    if features.comparable() {
        return Ok(features);
    }
    let message = format!("gives features of episode {of} that are not finite; train the encoder again");
    Err(LearnError::Checkpoint(message))
}

/// A running computation.
pub(super) struct Run<'a> {
    pub(super) encoder: Encoder<'a>,
    pub(super) comparison: &'a Comparison,
    /// Experts in the order of their numbers.
    pub(super) experts: &'a [&'a Trajectory],
    /// For every number, the expert's index in the given order.
    pub(super) places: &'a [u32],
    pub(super) known: &'a Known<'a>,
    /// Features of earlier runs; `None` where storing them does not pay off.
    pub(super) kept: Option<&'a dyn FeatureStore>,
    pub(super) progress: Progress<'a>,
}

/// The result of a run, without q.
pub(super) struct Found {
    /// The imperfect episodes, in the given order.
    pub(super) imperfect: Vec<EpisodeScores>,
    /// The experts, each against the others.
    pub(super) experts: Vec<EpisodeScores>,
    /// Per expert and segment, the local scale; `None` if similarities are not scaled.
    pub(super) local: Option<Vec<Vec<f64>>>,
}

/// The indexes that queries are compared with.
struct Indexes {
    all: Index,
    /// The experts that the earlier run lacks; `None` if it lacks none.
    new: Option<Index>,
}

impl Run<'_> {
    /// The scores of the imperfect episodes and of the experts, each in the order of `imperfect`
    /// and of the numbers, without q.
    pub(super) fn scores(mut self, imperfect: &[Trajectory]) -> Result<Found, LearnError> {
        let had = self.known.had();
        let news = self.places.len() > had.len();
        let known = |episode: &Trajectory| self.known.matches(&episode.id).is_some();
        let plain = !self.comparison.local_scale;
        if plain
            && !news
            && imperfect.iter().all(known)
            && (self.experts.len() < 2 || self.experts.iter().all(|e| known(e)))
        {
            self.progress.advance(usize::try_from(self.progress.total).unwrap_or(usize::MAX))?;
            return Ok(self.unchanged(imperfect));
        }
        let mut features = Vec::with_capacity(self.experts.len());
        for expert in self.experts {
            features.push(self.exact(expert)?);
        }
        let metric = metric(self.comparison.similarity, self.comparison.scale);
        let numbered: Vec<(u32, &Features)> = (0..).zip(&features).collect();
        let new: Vec<(u32, &Features)> = numbered.iter().filter(|(number, _)| !had.contains(number)).copied().collect();
        let indexes = Indexes {
            all: Index::new(&numbered, metric)?,
            new: (!had.is_empty() && news).then(|| Index::new(&new, metric)).transpose()?,
        };
        let mut scored = Vec::with_capacity(imperfect.len());
        for episode in imperfect {
            scored.push(self.imperfect(episode, &indexes)?);
        }
        let mut experts = Vec::with_capacity(self.experts.len());
        for (expert, features) in self.experts.iter().zip(&features) {
            let known = self.known.matches(&expert.id);
            experts.extend(self.nearest((&expert.id, Role::Expert), features, &indexes, known)?);
            self.progress.advance(features.count())?;
        }
        let local = if plain { None } else { self.local(&features, metric, &experts)? };
        Ok(Found { imperfect: scored, experts, local })
    }

    /// The local scale around each segment of the experts; `None` with a single expert.
    fn local(
        &mut self,
        features: &[Features],
        metric: Metric,
        experts: &[EpisodeScores],
    ) -> Result<Option<Vec<Vec<f64>>>, LearnError> {
        if experts.is_empty() {
            return Ok(None);
        }
        let alone: Vec<&[f64]> = experts.iter().map(|expert| expert.w.as_slice()).collect();
        let progress = &mut self.progress;
        local::means(features, metric, &alone, || progress.advance(0)).map(Some)
    }

    /// The result of a run without any new comparison: the scores of the earlier run.
    fn unchanged(&self, imperfect: &[Trajectory]) -> Found {
        let same = |episode: &Trajectory, role| {
            let matches: Vec<Match> = self.known.matches(&episode.id)?.into_iter().flatten().collect();
            Some(self.describe(&episode.id, role, &matches))
        };
        Found {
            imperfect: imperfect.iter().filter_map(|episode| same(episode, Role::Imperfect)).collect(),
            experts: self.experts.iter().filter_map(|expert| same(expert, Role::Expert)).collect(),
            local: None,
        }
    }

    fn imperfect(&mut self, episode: &Trajectory, indexes: &Indexes) -> Result<EpisodeScores, LearnError> {
        let known = self.known.matches(&episode.id);
        if let (Some(known), None) = (&known, &indexes.new) {
            let matches: Vec<Match> = known.iter().flatten().copied().collect();
            self.progress.advance(matches.len())?;
            return Ok(self.describe(&episode.id, Role::Imperfect, &matches));
        }
        let kept = self.kept_features(episode);
        if let (Some(known), Some(new), Some(Kept::Rough(rough))) = (&known, &indexes.new, &kept)
            && self.stay(episode, new, rough, known)?
        {
            let matches: Vec<Match> = known.iter().flatten().copied().collect();
            self.progress.advance(matches.len())?;
            return Ok(self.describe(&episode.id, Role::Imperfect, &matches));
        }
        let features = match kept {
            Some(Kept::Exact(features)) => features,
            Some(Kept::Rough(_)) => self.encoded(episode)?,
            None => {
                let features = self.encoded(episode)?;
                self.keep(episode, kept::rough_bytes(&features));
                features
            }
        };
        self.progress.advance(features.count())?;
        self.nearest((&episode.id, Role::Imperfect), &features, indexes, known)?.ok_or_else(|| {
            LearnError::invalid(
                format!("episode {}", episode.id),
                "is also the only expert, and an episode never matches itself; leave it out or add experts",
            )
        })
    }

    /// The nearest expert segments of episode `id`, without an expert of the same id; `None` if no expert is left.
    fn nearest(
        &self,
        (id, role): (&str, Role),
        queries: &Features,
        indexes: &Indexes,
        known: Option<Vec<Option<Match>>>,
    ) -> Result<Option<EpisodeScores>, LearnError> {
        let own = self.number(id);
        let matches = match (known, &indexes.new) {
            (None, _) => indexes.all.nearest(queries, own)?,
            (Some(mut known), new) => {
                if let Some(new) = new {
                    new.improve(queries, own, &mut known)?;
                }
                known.into_iter().collect::<Option<Vec<Match>>>()
            }
        };
        Ok(matches.map(|matches| self.describe(id, role, &matches)))
    }

    /// Whether all segments of an episode keep their known matches, by its rounded features.
    fn stay(
        &self,
        episode: &Trajectory,
        new: &Index,
        rough: &Rough,
        known: &[Option<Match>],
    ) -> Result<bool, LearnError> {
        let metric = metric(self.comparison.similarity, self.comparison.scale);
        let nearest = new.nearest(rough.points(), self.number(&episode.id))?;
        Ok(nearest.is_none_or(|nearest| rough.stay(known, &nearest, &metric)))
    }

    /// The number of the expert of this id.
    fn number(&self, id: &str) -> Option<u32> {
        let own = self.experts.binary_search_by(|expert| expert.id.as_str().cmp(id)).ok();
        own.and_then(|number| u32::try_from(number).ok())
    }

    /// The features of an expert, which all others are compared with, so they are kept as they are.
    fn exact(&mut self, expert: &Trajectory) -> Result<Features, LearnError> {
        let features = if let Some(Kept::Exact(features)) = self.kept_features(expert) {
            features
        } else {
            let features = self.encoded(expert)?;
            self.keep(expert, kept::exact_bytes(&features));
            features
        };
        self.progress.advance(features.count())?;
        Ok(features)
    }

    fn kept_features(&self, trajectory: &Trajectory) -> Option<Kept> {
        let network = self.encoder.network;
        let bytes = self.kept?.get(&trajectory.id)?;
        kept::from_bytes(&bytes, trajectory.steps(), widths(network, self.comparison))
    }

    fn encoded(&self, trajectory: &Trajectory) -> Result<Features, LearnError> {
        sound(episode_features(self.encoder, trajectory, self.comparison)?, &trajectory.id)
    }

    fn keep(&self, trajectory: &Trajectory, bytes: Result<Vec<u8>, LearnError>) {
        if let (Some(store), Ok(bytes)) = (self.kept, bytes) {
            store.put(&trajectory.id, &bytes);
        }
    }

    fn describe(&self, id: &str, role: Role, matches: &[Match]) -> EpisodeScores {
        EpisodeScores {
            episode_id: id.to_owned(),
            role,
            // Not −distance, which would make −0 of the best w.
            w: matches.iter().map(|found| 0.0 - found.distance).collect(),
            q: Vec::new(),
            match_episode: matches.iter().map(|found| self.places[found.group as usize]).collect(),
            match_step: matches.iter().map(|found| found.row).collect(),
            distances: matches.iter().map(|found| found.parts).collect(),
        }
    }
}
