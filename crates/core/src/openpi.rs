//! The keys by which observations of openpi's clients name the cameras and proprioception fields of a task. Independent of
//! messages.

use crate::TaskSpec;

/// First part of keys, which clients send or leave out.
const OBSERVATION: &str = "observation/";

/// A key without its first part `observation/`.
#[must_use]
pub fn within(key: &str) -> &str {
    key.strip_prefix(OBSERVATION).unwrap_or(key)
}

impl TaskSpec {
    /// The keys of a camera's pictures without `observation/`, of which the first that a message has counts: the one that
    /// the task names, or those of the camera's name.
    #[must_use]
    pub fn openpi_color(&self, camera: &str) -> Vec<String> {
        match self.openpi_key(camera) {
            Some(key) => vec![key.to_owned()],
            None => vec![camera.to_owned(), format!("images/{camera}"), format!("image/{camera}")],
        }
    }

    /// As [`TaskSpec::openpi_color`], of its depth.
    #[must_use]
    pub fn openpi_depth(&self, camera: &str) -> Vec<String> {
        self.openpi_color(camera).into_iter().map(|key| format!("{key}_depth")).collect()
    }

    /// The key without `observation/` that the task names for a camera or field, if it names one.
    #[must_use]
    pub fn openpi_key(&self, name: &str) -> Option<&str> {
        self.openpi.iter().find(|given| given.name == name).map(|given| within(&given.key))
    }
}
