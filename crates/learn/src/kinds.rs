//! Every policy, weighting, objective and scorer of this crate as data, for `gleaner-core`.

use gleaner_core::kinds::Kinds;

/// Every kind, as described in its own file.
#[must_use]
pub fn kinds() -> Kinds {
    Kinds {
        policies: crate::policy::describe(),
        weightings: crate::weighting::describe(),
        objectives: crate::objective::describe(),
        scorers: crate::score::scorer::describe(),
    }
}

#[cfg(test)]
mod tests {
    /// The file is written by `make kinds`.
    #[test]
    fn the_embedded_kinds_are_those_of_this_crate() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../core/kinds.json");
        let written = serde_json::to_string_pretty(&super::kinds()).unwrap() + "\n";
        assert_eq!(std::fs::read_to_string(file).unwrap(), written, "run `make kinds`");
    }
}
