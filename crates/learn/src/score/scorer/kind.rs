//! The definition of a scorer: a comparison of segments with those of experts, or a network trained on all episodes.
//! Must not depend on the list of scorers.

use gleaner_core::kinds::{Kind, Needs};
use gleaner_core::schema::integer_in;
use gleaner_core::{Chosen, Setting};

use crate::error::LearnError;
use crate::model::Network;
use crate::score::EpisodeScores;
use crate::score::comparison::Comparison;
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

/// Scores the (experts, imperfect) episodes, without q, as (imperfect, experts), each in the given order.
pub(in crate::score) type Trained = Box<
    dyn Fn(
            &Network,
            (&[Trajectory], &[Trajectory]),
            &mut dyn Monitor,
        ) -> Result<(Vec<EpisodeScores>, Vec<EpisodeScores>), LearnError>
        + Send,
>;

impl Scorer {
    /// The comparison of segments; `None` for a scorer that is trained.
    pub(in crate::score) fn comparison(&self) -> Option<&Comparison> {
        match self {
            Self::Nearest(comparison) => Some(comparison),
            Self::Trained(_) => None,
        }
    }
}
