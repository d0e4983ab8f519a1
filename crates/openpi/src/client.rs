//! The other side of the protocol: an observation for a server of openpi, and the actions in its answer.
//!
//! Must not know tasks; the answers are untrusted.

use gleaner_core::{Error, Result};
use rmpv::Value as Packed;

use crate::array::{Array, packed, text};

/// The deepest nesting of an answer.
const NESTED: usize = 32;
/// What separates the names of nested maps in a key.
const WITHIN: &str = "->";

/// A value of an observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value<'a> {
    /// Bytes of this shape.
    Bytes(&'a [usize], &'a [u8]),
    /// Little-endian 16-bit numbers of this shape.
    Words(&'a [usize], &'a [u8]),
    /// A vector of numbers.
    Numbers(&'a [f32]),
    /// A text, such as `prompt`.
    Text(&'a str),
}

/// An observation as a message. A name such as `images->cam_high` is the key `cam_high` of the map `images`.
#[must_use]
pub fn observation(values: &[(&str, Value<'_>)]) -> Vec<u8> {
    let mut map = Vec::new();
    for (name, value) in values {
        insert(&mut map, name, pack(value));
    }
    let mut message = Vec::new();
    // Writing to memory cannot fail.
    let _ = rmpv::encode::write_value(&mut message, &Packed::Map(map));
    message
}

fn insert(map: &mut Vec<(Packed, Packed)>, name: &str, value: Packed) {
    let Some((outer, inner)) = name.split_once(WITHIN) else {
        map.push((name.into(), value));
        return;
    };
    let at = map.iter().position(|(key, value)| key.as_str() == Some(outer) && value.is_map());
    let at = at.unwrap_or_else(|| {
        map.push((outer.into(), Packed::Map(Vec::new())));
        map.len() - 1
    });
    if let Packed::Map(nested) = &mut map[at].1 {
        insert(nested, inner, value);
    }
}

fn pack(value: &Value<'_>) -> Packed {
    match value {
        Value::Bytes(shape, data) => packed("|u1", shape, data.to_vec()),
        Value::Words(shape, data) => packed("<u2", shape, data.to_vec()),
        Value::Numbers(numbers) => {
            packed("<f4", &[numbers.len()], numbers.iter().flat_map(|number| number.to_le_bytes()).collect())
        }
        Value::Text(text) => (*text).into(),
    }
}

/// Checks the first message of a server: a map of anything.
///
/// # Errors
/// Invalid for anything else.
pub fn server_metadata(message: &[u8]) -> Result<()> {
    map(message).map(|_| ())
}

/// The shape and values of the array of this name in an answer.
///
/// # Errors
/// Invalid for a message that is not a map, or without such an array of numbers.
pub fn actions(message: &[u8], name: &str) -> Result<(Vec<usize>, Vec<f32>)> {
    let answer = map(message)?;
    let found = name.split(WITHIN).try_fold(&answer, |value, name| {
        value.as_map()?.iter().find(|(key, _)| text(key) == Some(name)).map(|(_, value)| value)
    });
    let Some(value) = found else {
        return Err(Error::invalid(name, "is missing in its answer"));
    };
    let array = Array::of(name, value)?;
    let array =
        array.ok_or_else(|| Error::invalid(name, "must be a numpy array, packed as openpi's client reads it"))?;
    let numbers = array.numbers();
    Ok((array.shape, numbers))
}

fn map(message: &[u8]) -> Result<Packed> {
    let mut rest = message;
    let value = rmpv::decode::read_value_with_max_depth(&mut rest, NESTED)
        .map_err(|error| Error::invalid("its message", format!("is not msgpack: {error}")))?;
    if rest.is_empty() && value.is_map() {
        return Ok(value);
    }
    Err(Error::invalid("its message", "is not one msgpack map"))
}

#[cfg(test)]
mod tests {
    use gleaner_core::{FieldSpec, TaskSpec};
    use proptest::prelude::*;

    use super::*;
    use crate::request::request;

    #[test]
    fn an_observation_is_what_gleaners_own_server_reads() {
        let task: TaskSpec = TaskSpec {
            name: "t".into(),
            instruction: String::new(),
            openpi: Vec::new(),
            rate_hz: 1.0,
            cameras: vec![gleaner_core::CameraSpec {
                name: "top".into(),
                height: 1,
                width: 2,
                depth: true,
                recorded: None,
            }],
            proprioception: vec![FieldSpec::new("joints", 2)],
            action: Vec::new(),
            alignment: gleaner_core::Alignment::default(),
            tolerance: 0.5,
            mappings: Vec::new(),
        };
        let message = observation(&[
            ("images->top", Value::Bytes(&[1, 2, 3], &[1, 2, 3, 4, 5, 6])),
            ("images->top_depth", Value::Words(&[1, 2], &[7, 0, 8, 0])),
            ("observation/state", Value::Numbers(&[0.5, -0.5])),
            ("prompt", Value::Text("pick")),
        ]);
        let nested = rmpv::decode::read_value(&mut &message[..]).unwrap();
        assert_eq!(nested.as_map().unwrap().len(), 3, "both pictures share a map");
        let message = observation(&[
            ("images->top", Value::Bytes(&[1, 2, 3], &[1, 2, 3, 4, 5, 6])),
            ("top_depth", Value::Words(&[1, 2], &[7, 0, 8, 0])),
            ("observation/state", Value::Numbers(&[0.5, -0.5])),
            ("prompt", Value::Text("pick")),
        ]);
        let read = request(&message, &task).unwrap();
        assert_eq!(read.proprioception, [0.5, -0.5]);
        assert_eq!(read.cameras[0].color.as_ref().unwrap().data, vec![1, 2, 3, 4, 5, 6]);
        assert_eq!(read.cameras[0].depth.as_ref().unwrap().data, vec![7, 0, 8, 0]);
    }

    #[test]
    fn the_reply_of_gleaners_own_server_is_read() {
        let rows = [vec![1.0, 2.0], vec![3.0, 4.0]];
        let reply = crate::Reply { actions: &rows, infer_ms: 1.0, policy_ms: 1.0, previous_ms: None, score: None };
        let message = crate::reply(&reply);
        assert_eq!(actions(&message, "actions").unwrap(), (vec![2, 2], vec![1.0, 2.0, 3.0, 4.0]));
        server_metadata(&message).unwrap();
        for (name, words) in [("action", "action: is missing"), ("server_timing", "must be a numpy array")] {
            assert!(actions(&message, name).unwrap_err().message().contains(words), "{name}");
        }
        assert!(actions(&message, "server_timing->x").is_err());
    }

    #[test]
    fn answers_that_are_no_maps_are_refused() {
        let nested = [vec![0x91; 100], vec![0xc0]].concat();
        for message in [&[][..], &[0xc0], &[0x80, 0x80], &[0xdf, 0xff, 0xff, 0xff, 0xff], &nested] {
            assert!(actions(message, "actions").unwrap_err().message().starts_with("its message: "), "{message:?}");
            assert!(server_metadata(message).is_err());
        }
    }

    proptest! {
        #[test]
        fn no_answer_panics(message in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = actions(&message, "actions");
            let _ = server_metadata(&message);
        }
    }
}
