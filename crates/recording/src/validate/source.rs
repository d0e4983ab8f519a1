//! The rules of one field's place in a mapping.

use super::{few, topic, wrong};
use crate::error::RecordingError;
use crate::path::Path;
use gleaner_core::{FieldSource, FieldSpec, TaskSpec, Transform};

/// Checks where a mapping takes a field from; `at` is its place in the task.
pub(super) fn check(spec: &TaskSpec, source: &FieldSource, at: &str) -> Result<(), RecordingError> {
    let Some(field) = spec.proprioception.iter().chain(&spec.action).find(|field| field.name == source.field) else {
        return wrong(format!("{at}.field"), format!("the task has no field `{}`", source.field));
    };
    topic(&format!("{at}.topic"), &source.topic, "topic of the messages")?;
    if let Some(transform) = &source.transform {
        return check_transform(field, source, transform, at);
    }
    if source.paths.is_empty() {
        return wrong(format!("{at}.paths"), "give at least one path into the message");
    }
    // Each path gives a value or more.
    few(&format!("{at}.paths"), source.paths.len(), field.size as usize)?;
    few(&format!("{at}.names"), source.names.len(), field.size as usize)?;
    for (i, path) in source.paths.iter().enumerate() {
        if let Err(problem) = Path::parse(path) {
            return wrong(format!("{at}.paths[{i}]"), problem);
        }
    }
    let picked = source.names.len() * source.paths.len();
    if picked != 0 && picked != field.size as usize {
        return wrong(
            format!("{at}.names"),
            format!("{picked} values are picked by name but `{}` holds {}; make them agree", field.name, field.size),
        );
    }
    Ok(())
}

fn check_transform(
    field: &FieldSpec,
    source: &FieldSource,
    transform: &Transform,
    at: &str,
) -> Result<(), RecordingError> {
    if !(source.paths.is_empty() && source.names.is_empty()) {
        return wrong(format!("{at}.paths"), "a field with a `transform` has neither paths nor names; leave them out");
    }
    if field.size != Transform::SIZE {
        let problem = format!(
            "a pose has {} values (x, y, z and the quaternion x, y, z, w) but `{}` holds {}; make them agree",
            Transform::SIZE,
            field.name,
            field.size
        );
        return wrong(format!("{at}.transform"), problem);
    }
    let Transform { parent, child, static_topic } = transform;
    topic(&format!("{at}.transform.parent"), parent, "frame in which the pose is")?;
    topic(&format!("{at}.transform.child"), child, "frame whose pose it is")?;
    let bare = |frame: &str| frame.strip_prefix('/').unwrap_or(frame).to_owned();
    if bare(parent) == bare(child) {
        return wrong(format!("{at}.transform.child"), format!("`{child}` is the parent, too; give another frame"));
    }
    if static_topic.is_empty() { Ok(()) } else { topic(&format!("{at}.transform.static_topic"), static_topic, "topic") }
}
