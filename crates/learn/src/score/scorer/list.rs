//! The list of scorers: a new one is a file and a line here.

use gleaner_core::Chosen;
use gleaner_core::kinds::{Family, Kind};

use super::{Scorer, ScorerKind, classifier, clock, deminf, progress, random, raw, ssdf, vote};
use crate::error::LearnError;
use crate::family;

/// Every scorer; the first is the default.
const SCORERS: [&ScorerKind; 8] = [
    &raw::KIND,
    &ssdf::KIND,
    &classifier::KIND,
    &deminf::KIND,
    &progress::KIND,
    &vote::KIND,
    &random::KIND,
    &clock::KIND,
];

/// The chosen scorer with its settings.
pub(in crate::score) fn open(chosen: &Chosen) -> Result<Scorer, LearnError> {
    (family::find(Family::Scorer, &SCORERS, |kind| kind.name, &chosen.name)?.open)(chosen)
}

/// Every scorer as data.
pub(crate) fn describe() -> Vec<Kind> {
    SCORERS.iter().map(|kind| kind.describe()).collect()
}
