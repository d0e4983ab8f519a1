//! Checks that a task specification makes sense by itself, before any recording is read.
//!
//! Knows the rules of [`TaskSpec`]. Must not know how recordings are read.

use std::collections::BTreeSet;

use crate::error::RecordingError;
use crate::frames::frame_bytes_per_step;
use crate::path::Path;
use crate::spec::{FieldSource, FieldSpec, Mapping, TaskSpec};

/// Largest image side that a task may ask for.
const MAX_IMAGE_SIDE: u32 = 8192;
/// Most numbers that one field may hold.
const MAX_FIELD_SIZE: u32 = 65_536;
/// Most bytes that the frames of one step may take.
const MAX_STEP_BYTES: usize = 1 << 30;

impl TaskSpec {
    /// Checks that the specification makes sense by itself.
    ///
    /// # Errors
    /// [`RecordingError::Spec`] names the first field that does not, and the mend.
    pub fn validate(&self) -> Result<(), RecordingError> {
        if !is_plain(&self.name) {
            return wrong("name", "use one or more of the characters a-z A-Z 0-9 _ - .");
        }
        if !(self.rate_hz.is_finite() && (0.01..=10_000.0).contains(&self.rate_hz)) {
            return wrong("rate_hz", "give the steps per second, from 0.01 to 10000");
        }
        if !(0.0..=0.5).contains(&self.tolerance) {
            return wrong("tolerance", "give a share of a period from 0 to 0.5");
        }
        self.validate_cameras()?;
        self.validate_fields()?;
        let mut names = BTreeSet::new();
        for (i, mapping) in self.mappings.iter().enumerate() {
            if !is_plain(&mapping.name) || !names.insert(&mapping.name) {
                return wrong(
                    format!("mappings[{i}].name"),
                    "give each mapping a name of its own, of the characters a-z A-Z 0-9 _ - .",
                );
            }
            self.validate_mapping(mapping, &format!("mappings[{i}]"))?;
        }
        Ok(())
    }

    fn validate_cameras(&self) -> Result<(), RecordingError> {
        let mut names = BTreeSet::new();
        for (i, camera) in self.cameras.iter().enumerate() {
            if !is_plain(&camera.name) || !names.insert(&camera.name) {
                return wrong(
                    format!("cameras[{i}].name"),
                    "give each camera a name of its own, of the characters a-z A-Z 0-9 _ - .",
                );
            }
            for (side, size) in [("height", camera.height), ("width", camera.width)] {
                if size == 0 || size > MAX_IMAGE_SIDE {
                    return wrong(
                        format!("cameras[{i}].{side}"),
                        format!("{size} pixels is outside 1 to {MAX_IMAGE_SIDE}"),
                    );
                }
            }
        }
        if frame_bytes_per_step(self) > MAX_STEP_BYTES {
            return wrong("cameras", "all images of a step together exceed 1 GiB; use smaller images");
        }
        Ok(())
    }

    fn validate_fields(&self) -> Result<(), RecordingError> {
        if self.action.is_empty() {
            return wrong("action", "give at least one action field");
        }
        let mut names = BTreeSet::new();
        for (kind, fields) in [("proprioception", &self.proprioception), ("action", &self.action)] {
            for (i, FieldSpec { name, size }) in fields.iter().enumerate() {
                if !is_identifier(name) || !names.insert(name) {
                    return wrong(
                        format!("{kind}[{i}].name"),
                        "give each field, of proprioception and action together, a name of its own: a letter, then \
                         letters, digits and _; `timestamp` is taken",
                    );
                }
                if *size == 0 || *size > MAX_FIELD_SIZE {
                    return wrong(
                        format!("{kind}[{i}].size"),
                        format!("{size} numbers is outside 1 to {MAX_FIELD_SIZE}"),
                    );
                }
            }
        }
        Ok(())
    }

    fn validate_mapping(&self, mapping: &Mapping, at: &str) -> Result<(), RecordingError> {
        for (i, source) in mapping.cameras.iter().enumerate() {
            let Some(camera) = self.cameras.iter().find(|camera| camera.name == source.camera) else {
                return wrong(
                    format!("{at}.cameras[{i}].camera"),
                    format!("the task has no camera `{}`", source.camera),
                );
            };
            if source.color.is_empty() {
                return wrong(format!("{at}.cameras[{i}].color"), "give the topic of the color images");
            }
            if camera.depth != source.depth.is_some() {
                let mend = if camera.depth {
                    "give the topic of the depth images"
                } else {
                    "the camera has no depth; leave it out"
                };
                return wrong(format!("{at}.cameras[{i}].depth"), mend);
            }
        }
        for (i, source) in mapping.fields.iter().enumerate() {
            self.validate_source(source, &format!("{at}.fields[{i}]"))?;
        }
        let cameras = self.cameras.iter().map(|camera| &camera.name);
        each_once(cameras, mapping.cameras.iter().map(|source| &source.camera), &format!("{at}.cameras"))?;
        let fields = self.proprioception.iter().chain(&self.action).map(|field| &field.name);
        each_once(fields, mapping.fields.iter().map(|source| &source.field), &format!("{at}.fields"))
    }

    fn validate_source(&self, source: &FieldSource, at: &str) -> Result<(), RecordingError> {
        let Some(field) = self.proprioception.iter().chain(&self.action).find(|field| field.name == source.field)
        else {
            return wrong(format!("{at}.field"), format!("the task has no field `{}`", source.field));
        };
        if source.topic.is_empty() {
            return wrong(format!("{at}.topic"), "give the topic of the messages");
        }
        if source.paths.is_empty() {
            return wrong(format!("{at}.paths"), "give at least one path into the message");
        }
        for (i, path) in source.paths.iter().enumerate() {
            if let Err(problem) = Path::parse(path) {
                return wrong(format!("{at}.paths[{i}]"), problem);
            }
        }
        let picked = source.names.len() * source.paths.len();
        if picked != 0 && picked != field.size as usize {
            return wrong(
                format!("{at}.names"),
                format!(
                    "{picked} values are picked by name but `{}` holds {}; make them agree",
                    field.name, field.size
                ),
            );
        }
        Ok(())
    }
}

/// Every wanted name has exactly one source.
fn each_once<'a>(
    wanted: impl Iterator<Item = &'a String>,
    given: impl Iterator<Item = &'a String>,
    at: &str,
) -> Result<(), RecordingError> {
    let mut seen = BTreeSet::new();
    for name in given {
        if !seen.insert(name) {
            return wrong(at, format!("`{name}` has two sources; keep one"));
        }
    }
    for name in wanted {
        if !seen.contains(name) {
            return wrong(at, format!("`{name}` has no source; add one"));
        }
    }
    Ok(())
}

fn wrong<T>(field: impl Into<String>, problem: impl Into<String>) -> Result<T, RecordingError> {
    Err(RecordingError::Spec { field: field.into(), problem: problem.into() })
}

fn is_plain(name: &str) -> bool {
    !name.is_empty() && name.len() <= 128 && name.chars().all(|c| c.is_ascii_alphanumeric() || "_-.".contains(c))
}

/// Field names become field names of protobuf messages, beside their `timestamp`.
fn is_identifier(name: &str) -> bool {
    name.len() <= 128
        && name != "timestamp"
        && name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use super::*;
    use crate::spec::tests::arm;

    fn problem(change: impl FnOnce(&mut TaskSpec)) -> String {
        let mut spec = arm();
        change(&mut spec);
        spec.validate().unwrap_err().to_string()
    }

    #[test]
    fn accepts_a_sound_task() {
        arm().validate().unwrap();
    }

    #[test]
    fn names_the_field_that_is_wrong() {
        assert!(problem(|s| s.rate_hz = f64::NAN).contains("rate_hz"));
        assert!(problem(|s| s.tolerance = 0.6).contains("tolerance"));
        assert!(problem(|s| s.name.clear()).contains("name"));
        assert!(problem(|s| s.action.clear()).contains("action"));
        assert!(problem(|s| s.cameras[0].height = 0).contains("cameras[0].height"));
        assert!(problem(|s| s.proprioception[0].name = "timestamp".into()).contains("proprioception[0].name"));
        assert!(problem(|s| s.action[0].name = "joint_position".into()).contains("action[0].name"));
        assert!(problem(|s| s.mappings[0].cameras.clear()).contains("`front` has no source"));
        assert!(problem(|s| s.mappings[0].fields[0].field = "elbow".into()).contains("no field `elbow`"));
        assert!(problem(|s| s.mappings[0].fields[0].paths = vec!["a[".into()]).contains("fields[0].paths[0]"));
        assert!(problem(|s| s.mappings[0].fields[0].names = vec!["a".into()]).contains("names"));
    }
}
