//! Checks of the keys of openpi's clients: each names one value, and no two cameras or fields are read from one key.

use std::collections::BTreeMap;

use gleaner_core::{OpenpiKey, TaskSpec};

use super::wrong;
use crate::error::RecordingError;

/// Longest key in bytes; that of a depth image has a suffix.
const MAX_KEY_BYTES: usize = 120;

pub(super) fn check(spec: &TaskSpec) -> Result<(), RecordingError> {
    let mut given: BTreeMap<&str, &str> = BTreeMap::new();
    for (i, OpenpiKey { name, key }) in spec.openpi.iter().enumerate() {
        let known = spec.cameras.iter().any(|camera| camera.name == *name)
            || spec.proprioception.iter().any(|field| field.name == *name);
        if !known || given.insert(name, key).is_some() {
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
    for (name, keys) in keys(spec, &given) {
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

/// The keys from which each camera and each proprioception field is read, without the part `observation/`.
fn keys<'a>(spec: &'a TaskSpec, given: &BTreeMap<&str, &str>) -> Vec<(&'a str, Vec<String>)> {
    let of_camera = |name: &str| match given.get(name) {
        Some(key) => vec![within(key).to_owned()],
        None => vec![name.to_owned(), format!("images/{name}"), format!("image/{name}")],
    };
    let cameras = spec.cameras.iter().map(|camera| {
        let mut keys = of_camera(&camera.name);
        if camera.depth {
            keys.extend(keys.clone().iter().map(|key| format!("{key}_depth")));
        }
        (camera.name.as_str(), keys)
    });
    let fields = spec.proprioception.iter().map(|field| {
        let key = given.get(field.name.as_str()).map_or(field.name.as_str(), |key| within(key));
        (field.name.as_str(), vec![key.to_owned()])
    });
    cameras.chain(fields).collect()
}

fn within(key: &str) -> &str {
    key.strip_prefix("observation/").unwrap_or(key)
}
