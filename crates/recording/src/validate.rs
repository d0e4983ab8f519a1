//! Checks of a task specification, before any recording is read.
//!
//! This module does not depend on the reader.

mod openpi;
mod source;

use std::collections::BTreeSet;

use crate::error::RecordingError;
use crate::frames::frame_bytes_per_step;
use crate::limits::Limits;
use gleaner_core::action::ActionRange;
use gleaner_core::{CameraSpec, FieldSpec, Mapping, TaskSpec};

/// Most cameras, fields of one kind, and mappings.
const MAX_CAMERAS: usize = 16;
const MAX_FIELDS: usize = 256;
const MAX_MAPPINGS: usize = 32;
/// Longest instruction in characters.
const MAX_INSTRUCTION: usize = 1000;
/// Longest topic in bytes.
const MAX_TOPIC_BYTES: usize = 1024;
/// Largest image side that a task may ask for.
const MAX_IMAGE_SIDE: u32 = 8192;
/// Longest unit of a field in characters.
const MAX_UNIT: usize = 100;
/// Most numbers that one field may hold.
const MAX_FIELD_SIZE: u32 = 65_536;
/// Most bytes that the frames of one step may take.
const MAX_STEP_BYTES: usize = 1 << 30;

/// Checks that the specification is consistent.
///
/// # Errors
/// [`RecordingError::Spec`] names the first invalid field and the fix.
pub fn validate(spec: &TaskSpec) -> Result<(), RecordingError> {
    if !is_plain(&spec.name) {
        return wrong("name", "use one or more of the characters a-z A-Z 0-9 _ - .");
    }
    if spec.instruction.chars().count() > MAX_INSTRUCTION || spec.instruction.chars().any(char::is_control) {
        return wrong("instruction", format!("give a text of at most {MAX_INSTRUCTION} characters in one line"));
    }
    if !(spec.rate_hz.is_finite() && (0.01..=10_000.0).contains(&spec.rate_hz)) {
        return wrong("rate_hz", "give the steps per second, from 0.01 to 10000");
    }
    if !(0.0..=0.5).contains(&spec.tolerance) {
        return wrong("tolerance", "give a share of a period from 0 to 0.5");
    }
    check_cameras(spec)?;
    check_fields(spec)?;
    openpi::check(spec)?;
    few("mappings", spec.mappings.len(), MAX_MAPPINGS)?;
    let mut names = BTreeSet::new();
    for (i, mapping) in spec.mappings.iter().enumerate() {
        if !is_plain(&mapping.name) || !names.insert(&mapping.name) {
            return wrong(
                format!("mappings[{i}].name"),
                "give each mapping a name of its own, of the characters a-z A-Z 0-9 _ - .",
            );
        }
        check_mapping(spec, mapping, &format!("mappings[{i}]"))?;
    }
    Ok(())
}

/// Like [`validate`], and checks the size of each image against these limits.
///
/// # Errors
/// Like [`validate`].
pub fn validate_within(spec: &TaskSpec, limits: &Limits) -> Result<(), RecordingError> {
    validate(spec)?;
    for (i, camera) in spec.cameras.iter().enumerate() {
        for (part, (height, width)) in [("", camera.sizes().step()), (".recorded", camera.sizes().recorded())] {
            let pixels = u64::from(height) * u64::from(width);
            if pixels > limits.image_pixels {
                return wrong(
                    format!("cameras[{i}]{part}"),
                    format!("{pixels} pixels are more than the limit of {}; use smaller images", limits.image_pixels),
                );
            }
        }
    }
    Ok(())
}

fn check_cameras(spec: &TaskSpec) -> Result<(), RecordingError> {
    few("cameras", spec.cameras.len(), MAX_CAMERAS)?;
    let mut names = BTreeSet::new();
    for (i, camera) in spec.cameras.iter().enumerate() {
        if !is_plain(&camera.name) || !names.insert(&camera.name) {
            return wrong(
                format!("cameras[{i}].name"),
                "give each camera a name of its own, of the characters a-z A-Z 0-9 _ - .",
            );
        }
        check_sides(&format!("cameras[{i}]"), camera.sizes().step())?;
        check_recorded(&format!("cameras[{i}].recorded"), camera)?;
    }
    if frame_bytes_per_step(spec) > MAX_STEP_BYTES {
        return wrong("cameras", "all images of a step together exceed 1 GiB; use smaller images");
    }
    Ok(())
}

fn check_sides(at: &str, (height, width): (u32, u32)) -> Result<(), RecordingError> {
    for (side, size) in [("height", height), ("width", width)] {
        if size == 0 || size > MAX_IMAGE_SIDE {
            return wrong(format!("{at}.{side}"), format!("{size} pixels is outside 1 to {MAX_IMAGE_SIDE}"));
        }
    }
    Ok(())
}

fn check_recorded(at: &str, camera: &CameraSpec) -> Result<(), RecordingError> {
    let Some(recorded) = camera.recorded else { return Ok(()) };
    check_sides(at, (recorded.height, recorded.width))?;
    let pixels = |(height, width)| u64::from(height) * u64::from(width);
    let (step, whole) = (camera.sizes().step(), camera.sizes().recorded());
    if pixels(step) == pixels(whole) && step != whole {
        let problem = "has as many pixels as a step, so the bytes of a raw picture do not show its size; give the step \
                       another size";
        return wrong(at, problem);
    }
    let Some(crop) = recorded.crop else { return Ok(()) };
    let ranges = [("height", crop.top, crop.height, recorded.height), ("width", crop.left, crop.width, recorded.width)];
    for (side, first, length, all) in ranges {
        if length == 0 || u64::from(first) + u64::from(length) > u64::from(all) {
            let problem =
                format!("{length} pixels from {first} on are not within the {all} recorded; give a part of them");
            return wrong(format!("{at}.crop.{side}"), problem);
        }
    }
    if step == whole && (crop.height, crop.width) != whole {
        let problem = "a step of the recorded size cannot show a part of it; give the step another size";
        return wrong(format!("{at}.crop"), problem);
    }
    Ok(())
}

fn check_fields(spec: &TaskSpec) -> Result<(), RecordingError> {
    if spec.action.is_empty() {
        return wrong("action", "give at least one action field");
    }
    let mut names = BTreeSet::new();
    for (kind, fields) in [("proprioception", &spec.proprioception), ("action", &spec.action)] {
        few(kind, fields.len(), MAX_FIELDS)?;
        for (i, field) in fields.iter().enumerate() {
            let FieldSpec { name, size, unit, .. } = field;
            if !is_identifier(name) || !names.insert(name) {
                return wrong(
                    format!("{kind}[{i}].name"),
                    "give each field, of proprioception and action together, a name of its own: a letter, then \
                     letters, digits and _; `timestamp` is taken",
                );
            }
            if *size == 0 || *size > MAX_FIELD_SIZE {
                return wrong(format!("{kind}[{i}].size"), format!("{size} numbers is outside 1 to {MAX_FIELD_SIZE}"));
            }
            if unit.chars().count() > MAX_UNIT || unit.chars().any(char::is_control) {
                let problem = format!("give a text of at most {MAX_UNIT} characters in one line");
                return wrong(format!("{kind}[{i}].unit"), problem);
            }
            check_range(field, kind, i)?;
        }
    }
    Ok(())
}

fn check_range(field: &FieldSpec, kind: &str, i: usize) -> Result<(), RecordingError> {
    let at = |part: &str| format!("{kind}[{i}].{part}");
    let FieldSpec { size, minimum, maximum, binary, .. } = field;
    if kind != "action" && (minimum.is_some() || maximum.is_some() || *binary) {
        return wrong(at("minimum"), "only fields of the action have `minimum`, `maximum` and `binary`; remove them");
    }
    for (part, bound) in [("minimum", minimum), ("maximum", maximum)] {
        let Some(bound) = bound else { continue };
        if let Some(count) = bound.count().filter(|count| *count != *size as usize) {
            let problem =
                format!("has {count} numbers for {size} values; give one for each, or a single number for all");
            return wrong(at(part), problem);
        }
        if (0..*size as usize).any(|index| bound.of(index).is_none_or(|bound| !bound.is_finite())) {
            return wrong(at(part), "give finite numbers, or leave it out");
        }
    }
    for (index, range) in ActionRange::of_values(field).enumerate() {
        if let (Some(minimum), Some(maximum), _) = range.bounds()
            && minimum >= maximum
        {
            let value = if *size > 1 { format!(" (value {index})") } else { String::new() };
            return wrong(at("maximum"), format!("{maximum} is not above the minimum {minimum}{value}"));
        }
    }
    if *binary && (minimum.is_none() || maximum.is_none()) {
        return wrong(at("binary"), "give the two values of a binary field as `minimum` and `maximum`");
    }
    Ok(())
}

fn check_mapping(spec: &TaskSpec, mapping: &Mapping, at: &str) -> Result<(), RecordingError> {
    few(&format!("{at}.cameras"), mapping.cameras.len(), MAX_CAMERAS)?;
    few(&format!("{at}.fields"), mapping.fields.len(), 2 * MAX_FIELDS)?;
    if let Some(clock) = &mapping.clock {
        topic(&format!("{at}.clock"), clock, "topic whose stamps are the steps")?;
    }
    for (i, source) in mapping.cameras.iter().enumerate() {
        let Some(camera) = spec.cameras.iter().find(|camera| camera.name == source.camera) else {
            return wrong(format!("{at}.cameras[{i}].camera"), format!("the task has no camera `{}`", source.camera));
        };
        topic(&format!("{at}.cameras[{i}].color"), &source.color, "topic of the color images")?;
        if let Some(depth) = &source.depth {
            topic(&format!("{at}.cameras[{i}].depth"), depth, "topic of the depth images")?;
        }
        if camera.depth != source.depth.is_some() {
            let fix = if camera.depth {
                "give the topic of the depth images"
            } else {
                "the camera has no depth; leave it out"
            };
            return wrong(format!("{at}.cameras[{i}].depth"), fix);
        }
    }
    for (i, source) in mapping.fields.iter().enumerate() {
        source::check(spec, source, &format!("{at}.fields[{i}]"))?;
    }
    let cameras = spec.cameras.iter().map(|camera| &camera.name);
    each_once(cameras, mapping.cameras.iter().map(|source| &source.camera), &format!("{at}.cameras"))?;
    let fields = spec.proprioception.iter().chain(&spec.action).map(|field| &field.name);
    each_once(fields, mapping.fields.iter().map(|source| &source.field), &format!("{at}.fields"))
}

/// Checks the length of a list.
fn few(field: &str, count: usize, most: usize) -> Result<(), RecordingError> {
    if count <= most {
        return Ok(());
    }
    wrong(field, format!("has {count} entries, more than {most}"))
}

fn topic(field: &str, topic: &str, what: &str) -> Result<(), RecordingError> {
    if topic.is_empty() {
        return wrong(field, format!("give the {what}"));
    }
    if topic.len() > MAX_TOPIC_BYTES || topic.chars().any(char::is_control) {
        return wrong(field, format!("give the {what}: at most {MAX_TOPIC_BYTES} bytes without control characters"));
    }
    Ok(())
}

/// Checks that every name has exactly one source.
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
mod tests;
