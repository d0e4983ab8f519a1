//! Checks of the keys of openpi's clients: each names one value, and no two cameras or fields are read from one key.

use std::collections::{BTreeMap, BTreeSet};

use gleaner_core::{OpenpiKey, TaskSpec, openpi::within};

use super::wrong;
use crate::error::RecordingError;

/// Longest key in bytes; that of a depth image has a suffix.
const MAX_KEY_BYTES: usize = 120;

pub(super) fn check(spec: &TaskSpec) -> Result<(), RecordingError> {
    let mut given = BTreeSet::new();
    for (i, OpenpiKey { name, key }) in spec.openpi.iter().enumerate() {
        let known = spec.cameras.iter().any(|camera| camera.name == *name)
            || spec.proprioception.iter().any(|field| field.name == *name);
        if !known || !given.insert(name) {
            return wrong(
                format!("openpi[{i}].name"),
                "name a camera or a proprioception field of the task, each at most once",
            );
        }
        if within(key).is_empty() || key.len() > MAX_KEY_BYTES || key.chars().any(char::is_control) {
            return wrong(
                format!("openpi[{i}].key"),
                format!("give a key of 1 to {MAX_KEY_BYTES} bytes, such as observation/wrist_image"),
            );
        }
    }
    let mut read: BTreeMap<String, &str> = BTreeMap::new();
    for (name, keys) in keys(spec) {
        for key in keys {
            if let Some(other) = read.insert(key.clone(), name).filter(|other| *other != name) {
                // Names without a key of their own are apart already, or read alike as they were before.
                let Some(i) = spec.openpi.iter().position(|given| given.name == name || given.name == *other) else {
                    continue;
                };
                return wrong(format!("openpi[{i}].key"), format!("{key} would be read for {other} and {name}"));
            }
        }
    }
    Ok(())
}

/// The keys from which each camera and each proprioception field is read.
fn keys(spec: &TaskSpec) -> Vec<(&str, Vec<String>)> {
    let cameras = spec.cameras.iter().map(|camera| {
        let depth = if camera.depth { spec.openpi_depth(&camera.name) } else { Vec::new() };
        (camera.name.as_str(), [spec.openpi_color(&camera.name), depth].concat())
    });
    let fields = spec.proprioception.iter().map(|field| {
        let key = spec.openpi_key(&field.name).unwrap_or(&field.name);
        (field.name.as_str(), vec![key.to_owned()])
    });
    cameras.chain(fields).collect()
}
