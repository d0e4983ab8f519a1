//! The scorer `raw`, a baseline: the nearest expert segment in the observations and actions themselves.

use gleaner_core::Group as _;
use gleaner_core::kinds::Needs;

use super::{Scorer, ScorerKind};
use crate::score::comparison::{Comparison, NearestSpec, Source};

pub(super) const KIND: ScorerKind = ScorerKind {
    name: "raw",
    title: "Raw nearest neighbour",
    about: "A baseline: the nearest expert segment in standardised images, proprioception and actions, without a network.",
    needs: Needs { encoder: true, history: false, images: true, all_episodes: false },
    settings: NearestSpec::schema,
    open: |chosen| Ok(Scorer::Nearest(Comparison::new(Source::Observations, chosen.read()?))),
};
