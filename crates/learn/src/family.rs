//! The choice of a kind by its name. Independent of the families' lists.

use gleaner_core::kinds::Family;

use crate::error::LearnError;

/// The kind of that name in the list of its family.
///
/// # Errors
/// [`LearnError::Invalid`], with the names that there are.
pub(crate) fn find<T>(
    family: Family,
    list: &[&'static T],
    name_of: fn(&T) -> &'static str,
    name: &str,
) -> Result<&'static T, LearnError> {
    list.iter().copied().find(|kind| name_of(kind) == name).ok_or_else(|| {
        let unlisted = || LearnError::invalid(family.as_str(), format!("{name} is missing in this program"));
        family.kind(name).err().map_or_else(unlisted, LearnError::from)
    })
}
