//! The list of objectives: a new one is a file and a line here.

use gleaner_core::kinds::{Family, Kind};

use super::{Objective, action_autoregression, masked_transition, reconstruction};
use crate::error::LearnError;
use crate::model::View;

/// Every objective, in the order in which their losses are added up.
const OBJECTIVES: [&Objective; 3] =
    [&masked_transition::OBJECTIVE, &reconstruction::OBJECTIVE, &action_autoregression::OBJECTIVE];

/// The objectives of these names, in the order of the list.
///
/// # Errors
/// [`LearnError::Invalid`] for no name, or for one that is not listed.
pub(crate) fn find(names: &[String]) -> Result<Vec<&'static Objective>, LearnError> {
    if let Some(unknown) = names.iter().find(|name| OBJECTIVES.iter().all(|listed| listed.name != **name)) {
        let known = Family::Objective.kind(unknown).err();
        return Err(known.map_or_else(|| LearnError::invalid("objectives", unknown.as_str()), LearnError::from));
    }
    let chosen: Vec<_> = OBJECTIVES.into_iter().filter(|listed| names.iter().any(|name| name == listed.name)).collect();
    if chosen.is_empty() {
        return Err(LearnError::invalid("objectives", "is empty; name at least one"));
    }
    Ok(chosen)
}

/// The pass from which features are taken: the paper's, in which all elements attend to each other; for an encoder
/// without an objective that trains it, the causal one.
pub(crate) fn features_view(objectives: &[String]) -> View<'static> {
    let trains = |name: &String| OBJECTIVES.iter().any(|listed| listed.name == name && listed.bidirectional);
    if objectives.iter().any(trains) { View::WHOLE } else { View::CAUSAL }
}

/// Every objective as data.
pub(crate) fn describe() -> Vec<Kind> {
    OBJECTIVES.iter().map(|objective| objective.describe()).collect()
}
