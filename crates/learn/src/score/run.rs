//! A score run by nearest expert segments, from the start or as an extension of an earlier run.

use std::collections::HashSet;

use gleaner_core::snapshot::Role;
use gleaner_search::{Match, Metric};

use super::EpisodeScores;
use super::alike::Copies;
use super::base::Known;
use super::comparison::Comparison;
use super::features::kept::{self, Kept};
use super::features::{Encoder, FeatureStore, Features, Rough, episode_features, features_from, shape as shape_of};
use super::form::{MATCHES, Matches, NUMBERS};
use super::indexes::Indexes;
use super::local::Spread;
use super::matched::{described, sound};
use super::reader::{Begun, Reader, Source};
use super::similarity::metric;
use crate::batch::Batch;
use crate::device;
use crate::error::LearnError;
use crate::shards::{Form, Shards};
use crate::trajectory::Trajectory;

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

impl Run<'_> {
    /// The scores of the imperfect episodes and of the experts, each in the order of `imperfect`
    /// and of the numbers, without q; `None` at a rank that does not lead.
    pub(super) fn scores(
        &self,
        imperfect: &[Trajectory],
        shards: &mut Shards<'_>,
    ) -> Result<Option<Found>, LearnError> {
        let had = self.known.had();
        let news = self.places.len() > had.len();
        let known = |episode: &Trajectory| self.known.matches(&episode.id).is_some();
        let plain = !self.comparison.local_scale;
        if plain
            && !news
            && imperfect.iter().all(known)
            && (self.experts.len() < 2 || self.experts.iter().all(|e| known(e)))
        {
            shards.finish()?;
            return Ok(shards.lead().then(|| self.unchanged(imperfect)));
        }
        let features = self.features(shards)?;
        let metric = metric(self.comparison.similarity, self.comparison.scale);
        let indexes = Indexes::new(&features, &had, metric)?;
        self.expect_others(&had, &indexes)?;
        let sizes: Vec<usize> = imperfect.iter().map(Trajectory::steps).collect();
        let own = shards.own(&sizes).into_iter().map(|at| &imperfect[at]);
        let own: Vec<&Trajectory> = own.filter(|episode| self.is_read(episode, &indexes)).collect();
        let scored = self.source().read_ahead(&own, |reader| {
            let mut score =
                |shards: &mut Shards<'_>, at: usize| self.imperfect(&imperfect[at], &indexes, (&mut *reader, shards));
            shards.at_lead(&sizes, &MATCHES, |shards, at| score(shards, at).map(Some))
        })?;
        let alone = shards.all(&self.sizes(), &MATCHES, |shards, at| {
            let (expert, features) = (self.experts[at], &features[at]);
            let known = self.known.matches(&expert.id);
            let matches = indexes.nearest(features, self.number(&expert.id), known)?;
            shards.advance(features.count())?;
            Ok(matches)
        })?;
        let experts = self.describe_all(self.experts.iter().copied(), Role::Expert, alone);
        let local = if plain { None } else { self.local((&features, &indexes.copies), metric, &experts, shards)? };
        let scored = scored.map(|scored| self.describe_all(imperfect, Role::Imperfect, scored));
        Ok(scored.map(|imperfect| Found { imperfect, experts, local }))
    }

    /// Fails if the earlier run, which `had` these experts, compared copies of one recording with each other, or could not
    /// compare its experts because all were copies: its normaliser does not fit the scores of this one.
    fn expect_others(&self, had: &HashSet<u32>, indexes: &Indexes) -> Result<(), LearnError> {
        let recordings: HashSet<u32> = had.iter().map(|number| indexes.copies.first(*number)).collect();
        if self.comparison.scaled_by_experts() && recordings.len() == 1 {
            return Err(unscaled("are copies of one recording"));
        }
        let matches_itself = |(number, expert): (u32, &&Trajectory)| {
            self.known.matches_of_expert(&expert.id).is_some_and(|known| indexes.are_within(number, &known))
        };
        if (0..).zip(self.experts).any(matches_itself) {
            let message = "match an expert with a copy of itself; score without extends";
            return Err(LearnError::invalid("base.scores", message));
        }
        Ok(())
    }

    /// The number of segments of every expert.
    fn sizes(&self) -> Vec<usize> {
        self.experts.iter().map(|expert| expert.steps()).collect()
    }

    /// The features of every expert.
    fn features(&self, shards: &mut Shards<'_>) -> Result<Vec<Features>, LearnError> {
        let read = |at: usize, bytes: &[u8]| match self.kept_from(bytes, self.experts[at])? {
            Kept::Exact(features) => Some(features),
            Kept::Rough(_) => None,
        };
        let form = Form { write: &kept::exact_bytes, read: &read };
        let sizes = self.sizes();
        let own: Vec<&Trajectory> = shards.own(&sizes).into_iter().map(|at| self.experts[at]).collect();
        self.source().read_ahead(&own, |reader| {
            shards.all(&sizes, &form, |shards, at| self.exact(self.experts[at], (&mut *reader, shards)))
        })
    }

    /// Where episodes are read from.
    fn source(&self) -> Source<'_> {
        let network = self.encoder.network;
        let (shape, device) = (&network.shape, network.device());
        let (points, threads) = (shape_of(network, self.comparison), device::assembling_threads(device));
        Source { shape, device, points, kept: self.kept, threads }
    }

    /// Whether an imperfect episode is read: one is not if its matches are known and no expert is new.
    fn is_read(&self, episode: &Trajectory, indexes: &Indexes) -> bool {
        indexes.new.is_some() || self.known.matches(&episode.id).is_none()
    }

    /// The local scale around each segment of the experts; `None` with a single one, or copies of a single one.
    fn local(
        &self,
        (features, copies): (&[Features], &Copies),
        metric: Metric,
        experts: &[EpisodeScores],
        shards: &mut Shards<'_>,
    ) -> Result<Option<Vec<Vec<f64>>>, LearnError> {
        if experts.is_empty() {
            return Ok(None);
        }
        let alone: Vec<&[f64]> = experts.iter().map(|expert| expert.w.as_slice()).collect();
        let spread = Spread::new((features, copies), metric, &alone);
        shards.at_lead(&self.sizes(), &NUMBERS, |shards, at| {
            let means = spread.around(at);
            shards.advance(0)?;
            Ok(means)
        })
    }

    /// The result of a run without any new comparison: the scores of the earlier run.
    fn unchanged(&self, imperfect: &[Trajectory]) -> Found {
        let same = |episode: &Trajectory, role| {
            let matches: Vec<Match> = self.known.matches(&episode.id)?.into_iter().flatten().collect();
            Some(self.describe(episode, role, &matches))
        };
        Found {
            imperfect: imperfect.iter().filter_map(|episode| same(episode, Role::Imperfect)).collect(),
            experts: self.experts.iter().filter_map(|expert| same(expert, Role::Expert)).collect(),
            local: None,
        }
    }

    fn imperfect(
        &self,
        episode: &Trajectory,
        indexes: &Indexes,
        (reader, shards): (&mut Reader<'_>, &mut Shards<'_>),
    ) -> Result<Vec<Match>, LearnError> {
        let known = self.known.matches(&episode.id);
        let unchanged = |known: &[Option<Match>]| known.iter().flatten().copied().collect();
        if let (Some(known), false) = (&known, self.is_read(episode, indexes)) {
            shards.advance(known.len())?;
            return Ok(unchanged(known));
        }
        let features = match reader.begin(episode)? {
            Begun::Kept(Kept::Exact(features)) => features,
            Begun::Kept(Kept::Rough(rough)) => {
                if let Some(known) = &known
                    && self.stay(episode, indexes, &rough, known)?
                {
                    shards.advance(known.len())?;
                    return Ok(unchanged(known));
                }
                sound(episode_features(self.encoder, episode, self.comparison)?, &episode.id)?
            }
            Begun::Steps(first) => {
                let features = self.encoded(episode, first, reader)?;
                self.keep(episode, || kept::rough_bytes(&features));
                features
            }
        };
        shards.advance(features.count())?;
        indexes.nearest(&features, self.number(&episode.id), known)?.ok_or_else(|| {
            LearnError::invalid(
                format!("episode {}", episode.id),
                "is also the only expert, and an episode never matches itself; leave it out or add experts",
            )
        })
    }

    /// Whether all segments of an episode keep their known matches, by its rounded features.
    fn stay(
        &self,
        episode: &Trajectory,
        indexes: &Indexes,
        rough: &Rough,
        known: &[Option<Match>],
    ) -> Result<bool, LearnError> {
        let Some(new) = &indexes.new else { return Ok(false) };
        let metric = metric(self.comparison.similarity, self.comparison.scale);
        let own = self.number(&episode.id).map(|number| indexes.copies.first(number));
        let nearest = new.nearest(rough.points(), own)?;
        Ok(nearest.is_none_or(|nearest| rough.stay(known, &nearest, &metric)))
    }

    /// The number of the expert of this id.
    fn number(&self, id: &str) -> Option<u32> {
        let own = self.experts.binary_search_by(|expert| expert.id.as_str().cmp(id)).ok();
        own.and_then(|number| u32::try_from(number).ok())
    }

    /// The features of an expert, which all others are compared with, so they are kept as they are.
    fn exact(
        &self,
        expert: &Trajectory,
        (reader, shards): (&mut Reader<'_>, &mut Shards<'_>),
    ) -> Result<Features, LearnError> {
        let (features, is_kept) = match reader.begin(expert)? {
            Begun::Kept(Kept::Exact(features)) => (features, true),
            Begun::Steps(first) => (self.encoded(expert, first, reader)?, false),
            // Of an earlier run, in which this episode was imperfect.
            Begun::Kept(Kept::Rough(_)) => {
                (sound(episode_features(self.encoder, expert, self.comparison)?, &expert.id)?, false)
            }
        };
        if !is_kept {
            self.keep(expert, || kept::exact_bytes(&features));
        }
        shards.advance(features.count())?;
        Ok(features)
    }

    fn kept_from(&self, bytes: &[u8], trajectory: &Trajectory) -> Option<Kept> {
        kept::from_bytes(bytes, trajectory.steps(), shape_of(self.encoder.network, self.comparison))
    }

    /// The features of an episode whose first chunk is read.
    fn encoded(&self, episode: &Trajectory, first: Batch, reader: &mut Reader<'_>) -> Result<Features, LearnError> {
        let mut first = Some(first);
        let mut next = || first.take().map_or_else(|| reader.chunk(), Ok);
        sound(features_from(self.encoder, episode, self.comparison, &mut next)?, &episode.id)
    }

    fn keep(&self, trajectory: &Trajectory, bytes: impl FnOnce() -> Result<Vec<u8>, LearnError>) {
        if let Some(store) = self.kept
            && let Ok(bytes) = bytes()
        {
            store.put(&trajectory.id, &bytes);
        }
    }

    /// The scores of those of `episodes` that have matches.
    fn describe_all<'e>(
        &self,
        episodes: impl IntoIterator<Item = &'e Trajectory>,
        role: Role,
        matches: Vec<Matches>,
    ) -> Vec<EpisodeScores> {
        let all = episodes.into_iter().zip(matches);
        all.filter_map(|(episode, matches)| Some(self.describe(episode, role, &matches?))).collect()
    }

    fn describe(&self, episode: &Trajectory, role: Role, matches: &[Match]) -> EpisodeScores {
        described((&episode.id, role), self.places, matches)
    }
}

/// The error for an earlier run whose experts could not be compared with each other.
pub(super) fn unscaled(experts: &str) -> LearnError {
    let consequence = "so its run had no scale among experts that its normaliser was fitted to; score without extends";
    LearnError::invalid("base.experts", format!("{experts}, {consequence}"))
}
