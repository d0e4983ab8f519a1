//! A client's map as an observation of a task.
//!
//! Must not know replies.

use bytes::Bytes;
use gleaner_core::observation::{CameraFrame, Image, ImageFormat};
use gleaner_core::{CameraSpec, FieldSpec, TaskSpec};
use gleaner_core::{Error, Result};
use rmpv::Value;

use crate::array::Array;
use crate::named::Named;

/// The deepest nesting of a message, above what any client sends.
const NESTED: usize = 32;

/// One message of a client.
#[derive(Debug, Clone)]
pub struct Request {
    /// Whether this observation begins a new episode: the key `reset`.
    pub reset: bool,
    /// A frame for each camera of the task.
    pub cameras: Vec<CameraFrame>,
    /// The task's proprioception.
    pub proprioception: Vec<f32>,
}

/// The size of the largest message that is read, in bytes: a task's observation in 64-bit numbers four times over, for
/// images and values beside it that a client sends anyway.
#[must_use]
pub fn largest_request(task: &TaskSpec) -> usize {
    let camera = |camera: &CameraSpec| {
        let (height, width) = camera.recorded.map_or((camera.height, camera.width), |size| (size.height, size.width));
        let pixels = height as usize * width as usize;
        pixels * if camera.depth { 5 } else { 3 }
    };
    let images: usize = task.cameras.iter().map(camera).sum();
    let values: usize = task.proprioception.iter().map(|field| field.size as usize * 8).sum();
    4 * (images + values) + (1 << 20)
}

/// Reads one message.
///
/// A camera `c` is the value `c`, `images/c` or `image/c`, and its depth `c_depth`; values are one vector `state`, or one of
/// the name of each field; a camera or field for which the task names a key has that key alone. Keys have `observation/`
/// before them or not. What else the message has is left.
///
/// # Errors
/// Invalid, naming what is missing or does not fit, and what was sent.
pub fn request(message: &[u8], task: &TaskSpec) -> Result<Request> {
    let mut rest = message;
    let value = rmpv::decode::read_value_with_max_depth(&mut rest, NESTED)
        .map_err(|error| Error::invalid("message", format!("is not msgpack: {error}")))?;
    if !rest.is_empty() || !value.is_map() {
        return Err(Error::invalid("message", "must be one msgpack map, such as {\"observation/state\": …}"));
    }
    let named = Named::of(&value);
    let cameras = task.cameras.iter().map(|camera| frame(&named, camera, task)).collect::<Result<_>>()?;
    let reset = named.first(&["reset"]).is_some_and(|value| value.as_bool() == Some(true));
    Ok(Request { reset, cameras, proprioception: values(&named, task)? })
}

fn frame(named: &Named<'_>, camera: &CameraSpec, task: &TaskSpec) -> Result<CameraFrame> {
    let color = picture(named, camera, &task.openpi_color(&camera.name), false)?;
    let depth = || picture(named, camera, &task.openpi_depth(&camera.name), true);
    let depth = camera.depth.then(depth).transpose()?;
    Ok(CameraFrame { camera: camera.name.clone(), color: Some(color), depth })
}

/// The picture under the first of `keys` that the message has.
fn picture(named: &Named<'_>, camera: &CameraSpec, keys: &[String], depth: bool) -> Result<Image> {
    let keys: Vec<&str> = keys.iter().map(String::as_str).collect();
    let field = format!("observation/{}", keys.first().copied().unwrap_or_default());
    let Some(value) = named.first(&keys) else {
        let words = "if the client names it otherwise, give its key in the task file ([[openpi]])";
        return Err(Error::invalid(&field, format!("is missing; the message has {}; {words}", named.listed())));
    };
    if let Value::Binary(encoded) = value {
        return Ok(Image { format: ImageFormat::Any, data: Bytes::copy_from_slice(encoded) });
    }
    let Some(array) = Array::of(&field, value)? else {
        return Err(Error::invalid(&field, "must be an array, or the bytes of a JPEG or PNG"));
    };
    let sizes = sizes(camera);
    let fits = |height: usize, width: usize| sizes.contains(&(height, width));
    let data = match array.shape[..] {
        [height, width] | [height, width, 1] if depth && array.is_words() && fits(height, width) => array.data.to_vec(),
        [height, width, 3] if !depth && array.is_bytes() && fits(height, width) => array.data.to_vec(),
        [3, height, width] if !depth && array.is_bytes() && fits(height, width) => {
            interleaved(array.data, height * width)
        }
        _ => return Err(unfit(&field, &array, &sizes, depth)),
    };
    Ok(Image { format: ImageFormat::Raw, data: data.into() })
}

/// The heights and widths that the server reads: that of recordings, which it crops and resizes, and that of a step.
fn sizes(camera: &CameraSpec) -> Vec<(usize, usize)> {
    let recorded = camera.recorded.map(|size| (size.height as usize, size.width as usize));
    recorded.into_iter().chain([(camera.height as usize, camera.width as usize)]).collect()
}

/// Channel by channel to pixel by pixel, as ALOHA's client sends its images.
fn interleaved(planes: &[u8], pixels: usize) -> Vec<u8> {
    (0..pixels).flat_map(|at| [planes[at], planes[pixels + at], planes[2 * pixels + at]]).collect()
}

fn unfit(field: &str, array: &Array<'_>, sizes: &[(usize, usize)], depth: bool) -> Error {
    let wanted: Vec<String> = sizes.iter().map(|(height, width)| format!("{height}×{width}")).collect();
    let (kind, layout) = if depth { ("uint16", "") } else { ("uint8", "×3") };
    let shown = &array.shape[..array.shape.len().min(8)];
    Error::invalid(field, format!("has shape {shown:?}; send {kind} of {}{layout}", wanted.join(" or ")))
}

fn values(named: &Named<'_>, task: &TaskSpec) -> Result<Vec<f32>> {
    let fields = &task.proprioception;
    let apart = fields.iter().any(|field| task.openpi_key(&field.name).is_some());
    let length = fields.iter().map(|field| field.size as usize).sum();
    if let Some(value) = named.first(&["state", "proprio"]).filter(|_| !apart) {
        return vector("observation/state", value, length, &described(fields));
    }
    let mut all = Vec::with_capacity(length);
    for field in fields {
        let key = task.openpi_key(&field.name).unwrap_or(&field.name);
        let name = format!("observation/{key}");
        let Some(value) = named.first(&[key]) else {
            let words = format!(
                "is missing; send observation/state ({}), or each field alone; the message has {}",
                described(fields),
                named.listed()
            );
            return Err(Error::invalid(&name, words));
        };
        all.extend(vector(&name, value, field.size as usize, &field.name)?);
    }
    Ok(all)
}

fn described(fields: &[FieldSpec]) -> String {
    fields.iter().map(|field| format!("{} {}", field.name, field.size)).collect::<Vec<_>>().join(", ")
}

fn vector(field: &str, value: &Value, length: usize, described: &str) -> Result<Vec<f32>> {
    #[expect(clippy::cast_possible_truncation, reason = "policies compute in 32-bit numbers")]
    let number = |value: &Value| value.as_f64().map(|value| value as f32);
    let found = match (Array::of(field, value)?, value.as_array()) {
        (Some(array), _) => Some(array.numbers()),
        (None, Some(values)) => values.iter().map(number).collect(),
        (None, None) => number(value).map(|value| vec![value]),
    };
    let found = found.ok_or_else(|| Error::invalid(field, "must be an array or a list of numbers"))?;
    if found.len() != length {
        return Err(Error::invalid(field, format!("has {} values, the task has {length}: {described}", found.len())));
    }
    Ok(found)
}

#[cfg(test)]
mod tests;
