//! JSON messages, which are read without a schema.
//!
//! The nesting depth is checked before a message is parsed, so that the stack stays bounded.

use super::Value;

/// Parses one JSON message of at most this nesting depth. Arrays of numbers become numeric arrays. A field that is null is
/// omitted; an element that is null is not a number and keeps its place, because writers of JSON have null for such numbers
/// and a path selects an element by its place.
pub(crate) fn decode(bytes: &[u8], depth: usize) -> Result<Value<'static>, String> {
    if deeper(bytes, depth) {
        return Err(format!("the message nests more than {depth} levels deep; record flatter messages"));
    }
    let json: serde_json::Value =
        serde_json::from_slice(bytes).map_err(|error| format!("the message is not JSON: {error}"))?;
    convert(json).ok_or_else(|| "the message is null".to_owned())
}

/// Whether arrays and objects are nested deeper than this. The result is irrelevant for text that is not JSON, which the
/// parser rejects.
fn deeper(bytes: &[u8], depth: usize) -> bool {
    let (mut level, mut in_text, mut escaped) = (0_usize, false, false);
    for byte in bytes {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if in_text => escaped = true,
            b'"' => in_text = !in_text,
            _ if in_text => {}
            b'[' | b'{' => level += 1,
            b']' | b'}' => level = level.saturating_sub(1),
            _ => {}
        }
        if level > depth {
            return true;
        }
    }
    false
}

fn convert(json: serde_json::Value) -> Option<Value<'static>> {
    use serde_json::Value as Json;
    Some(match json {
        Json::Null => return None,
        Json::Bool(flag) => Value::Number(f64::from(u8::from(flag))),
        Json::Number(number) => Value::Number(number.as_f64()?),
        Json::String(text) => Value::Text(text.into()),
        Json::Array(items) if items.iter().all(|item| item.is_number() || item.is_null()) => {
            Value::Numbers(items.iter().map(|item| item.as_f64().unwrap_or(f64::NAN)).collect())
        }
        Json::Array(items) => {
            let element = |item| convert(item).unwrap_or(Value::Number(f64::NAN));
            Value::List(items.into_iter().map(element).collect())
        }
        Json::Object(fields) => Value::Message(
            fields.into_iter().filter_map(|(name, value)| Some((name.into(), convert(value)?))).collect(),
        ),
    })
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::limits::MOST_JSON_DEPTH;

    #[test]
    fn reads_fields_arrays_and_stamp() {
        let text = br#"{"timestamp":{"sec":3,"nsec":4},"q":[1,2.5],"on":true,"by":"me","gone":null}"#;
        let value = decode(text, 64).unwrap();
        assert_eq!(value.stamp(), Some(3_000_000_004));
        assert_eq!(value.field("q"), Some(&Value::Numbers(vec![1.0, 2.5])));
        assert_eq!(value.number("on"), Some(1.0));
        assert_eq!(value.text("by"), Some("me"));
        assert_eq!(value.field("gone"), None);
    }

    #[test]
    fn null_keeps_its_place_in_an_array() {
        let value = decode(br#"{"q":[1,null,3],"parts":[{"x":1},null,{"x":2}]}"#, 64).unwrap();
        let Some(Value::Numbers(numbers)) = value.field("q") else { panic!("{value:?}") };
        assert!(numbers.len() == 3 && numbers[1].is_nan() && numbers[2] == 3.0, "{numbers:?}");
        let Some(Value::List(parts)) = value.field("parts") else { panic!("{value:?}") };
        assert_eq!((parts.len(), parts[2].number("x")), (3, Some(2.0)));
    }

    #[test]
    fn malformed_json_is_rejected() {
        assert!(decode(b"{", 64).unwrap_err().contains("not JSON"));
        assert!(decode(b"\"\\", 64).is_err());
    }

    #[test]
    fn depth_is_counted_but_not_in_texts() {
        let nested = |levels: usize| format!("{}1{}", "[".repeat(levels), "]".repeat(levels));
        assert!(decode(nested(64).as_bytes(), 64).is_ok());
        assert!(decode(nested(65).as_bytes(), 64).unwrap_err().contains("64 levels"));
        assert!(decode(nested(MOST_JSON_DEPTH).as_bytes(), MOST_JSON_DEPTH).is_ok());
        assert!(decode("[".repeat(10_000_000).as_bytes(), MOST_JSON_DEPTH).unwrap_err().contains("levels"));
        assert!(decode(br#"{"a":"[[[[[\"[[[[","b":[[1],[2]]}"#, 3).is_ok());
    }
}
