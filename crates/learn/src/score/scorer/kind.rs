//! The definition of a scorer: a comparison of segments with those of experts, or a network trained on all episodes.
//! Must not depend on the list of scorers.

use gleaner_core::kinds::{Kind, Needs};
use gleaner_core::schema::integer_in;
use gleaner_core::snapshot::Role;
use gleaner_core::{Chosen, Setting};

use crate::error::LearnError;
use crate::model::Network;
use crate::progress::Progress;
use crate::score::EpisodeScores;
use crate::score::comparison::{Comparison, FeatureScale};
use crate::score::count;
use crate::score::features::Encoder;
use crate::train::Monitor;
use crate::trajectory::Trajectory;

/// One kind of scorer.
pub(super) struct ScorerKind {
    /// The word in settings, such as `ssdf`.
    pub(super) name: &'static str,
    /// The name for people.
    pub(super) title: &'static str,
    /// Description in one sentence.
    pub(super) about: &'static str,
    /// Its requirements.
    pub(super) needs: Needs,
    /// Its settings besides those of every score run.
    pub(super) settings: fn() -> Vec<Setting>,
    /// The scorer with its settings.
    pub(super) open: fn(&Chosen) -> Result<Scorer, LearnError>,
}

impl ScorerKind {
    /// Its description as data.
    pub(super) fn describe(&self) -> Kind {
        let [name, title, about] = [self.name, self.title, self.about].map(str::to_owned);
        Kind { name, title, about, needs: self.needs, settings: (self.settings)() }
    }
}

gleaner_core::settings! {
    /// Settings of a scorer that draws random numbers.
    pub(super) struct SeedSpec {
        /// Seed of the scorer's random numbers.
        pub(super) seed: u64 = 0, integer_in(0, u64::MAX);
    }
}

/// A scorer with its settings.
pub(in crate::score) enum Scorer {
    /// Scores by the nearest expert segment.
    Nearest(Comparison),
    /// Scores by a model trained on all episodes at once.
    Trained(Trained),
}

/// A scorer whose every score depends on all episodes.
pub(in crate::score) struct Trained {
    /// Scaling of the encoder's features; `None` if it does not use them.
    pub(super) feature_scale: Option<FeatureScale>,
    /// Its computation.
    pub(in crate::score) scores: TrainedScores,
}

/// Scores the (experts, imperfect) episodes, without q, as (imperfect, experts), each in the given order.
pub(super) type TrainedScores = Box<
    dyn Fn(
            Encoder<'_>,
            (&[Trajectory], &[Trajectory]),
            &mut dyn Monitor,
        ) -> Result<(Vec<EpisodeScores>, Vec<EpisodeScores>), LearnError>
        + Send,
>;

/// Scores by a seed, from (experts, imperfect) episodes to (imperfect, experts), without q.
type Seeded = fn(
    &Network,
    (&[Trajectory], &[Trajectory]),
    u64,
    &mut dyn Monitor,
) -> Result<(Vec<EpisodeScores>, Vec<EpisodeScores>), LearnError>;

/// A scorer that has a seed as its only setting, and uses no features after attention.
pub(super) fn seeded(chosen: &Chosen, scores: Seeded) -> Result<Scorer, LearnError> {
    let SeedSpec { seed } = chosen.read()?;
    Ok(Scorer::Trained(Trained {
        feature_scale: None,
        scores: Box::new(move |encoder, episodes, monitor| scores(encoder.network, episodes, seed, monitor)),
    }))
}

/// The scores of the (experts, imperfect) episodes by a scorer that looks at each alone, without q, as (imperfect, experts),
/// each in the given order. `w` gives those of the segments of an episode.
pub(super) fn unmatched_each(
    (experts, imperfect): (&[Trajectory], &[Trajectory]),
    monitor: &mut dyn Monitor,
    w: impl Fn(&Trajectory) -> Vec<f64>,
) -> Result<(Vec<EpisodeScores>, Vec<EpisodeScores>), LearnError> {
    let mut progress = Progress::of_segments(monitor, count(experts.iter().chain(imperfect)));
    let mut score = |episodes: &[Trajectory], role| -> Result<Vec<EpisodeScores>, LearnError> {
        let scored = episodes.iter().map(|episode| {
            progress.advance(episode.steps())?;
            Ok(unmatched(&episode.id, role, w(episode)))
        });
        scored.collect()
    };
    Ok((score(imperfect, Role::Imperfect)?, score(experts, Role::Expert)?))
}

/// The scores of an episode by a scorer that matches no segments, without q.
pub(super) fn unmatched(episode: &str, role: Role, w: Vec<f64>) -> EpisodeScores {
    EpisodeScores {
        episode_id: episode.to_owned(),
        role,
        w,
        q: Vec::new(),
        match_episode: Vec::new(),
        match_step: Vec::new(),
        distances: Vec::new(),
    }
}

impl Scorer {
    /// The comparison that alone decides the score of a segment; `None` for a scorer that is trained.
    pub(in crate::score) fn comparison(&self) -> Option<&Comparison> {
        match self {
            Self::Nearest(comparison) => Some(comparison),
            Self::Trained(_) => None,
        }
    }

    /// Scaling of the encoder's features; `None` for a scorer that does not use them.
    pub(in crate::score) fn feature_scale(&self) -> Option<FeatureScale> {
        match self {
            Self::Nearest(comparison) => comparison.source.feature_scale(),
            Self::Trained(trained) => trained.feature_scale,
        }
    }
}
