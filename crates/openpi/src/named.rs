//! The values of a client's map by name, however it nests them.
//!
//! Must not know tasks.

use gleaner_core::openpi::within;
use gleaner_core::printable;
use rmpv::Value;

use crate::array::{is_array, text};

/// The deepest nesting that is looked into: `observation`, `images`, and the camera.
const DEPTH: usize = 4;
/// The most names that an error lists.
const LISTED: usize = 16;

/// Values by their names; names of nested maps are joined by `/`, and a first part `observation` is left out.
pub(crate) struct Named<'a>(Vec<(String, &'a Value)>);

impl<'a> Named<'a> {
    pub(crate) fn of(map: &'a Value) -> Self {
        let mut found = Vec::new();
        collect("", map, DEPTH, &mut found);
        Self(found)
    }

    /// The first value with one of these names.
    pub(crate) fn first(&self, names: &[&str]) -> Option<&'a Value> {
        names.iter().find_map(|wanted| self.0.iter().find(|(name, _)| name == wanted).map(|(_, value)| *value))
    }

    /// The names, for an error.
    pub(crate) fn listed(&self) -> String {
        let mut names: Vec<String> =
            self.0.iter().take(LISTED).map(|(name, _)| printable::field(name).into_owned()).collect();
        if self.0.len() > LISTED {
            names.push("…".to_owned());
        }
        if names.is_empty() { "nothing".to_owned() } else { names.join(", ") }
    }
}

fn collect<'a>(path: &str, value: &'a Value, depth: usize, found: &mut Vec<(String, &'a Value)>) {
    if let Value::Map(entries) = value
        && depth > 0
        && !is_array(entries)
    {
        for (key, value) in entries {
            let Some(key) = text(key) else { continue };
            let path = if path.is_empty() { key.to_owned() } else { format!("{path}/{key}") };
            collect(&path, value, depth - 1, found);
        }
        return;
    }
    let name = within(path);
    found.push((name.chars().take(128).collect(), value));
}
