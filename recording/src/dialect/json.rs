//! JSON messages: read without their schema, since they describe themselves.

use super::Value;

/// Reads one JSON message. Arrays of numbers become numeric arrays; null is left out.
pub(crate) fn decode(bytes: &[u8]) -> Result<Value<'static>, String> {
    let json: serde_json::Value =
        serde_json::from_slice(bytes).map_err(|error| format!("the message is not JSON: {error}"))?;
    convert(json).ok_or_else(|| "the message is null".to_owned())
}

fn convert(json: serde_json::Value) -> Option<Value<'static>> {
    use serde_json::Value as Json;
    Some(match json {
        Json::Null => return None,
        Json::Bool(flag) => Value::Number(f64::from(u8::from(flag))),
        Json::Number(number) => Value::Number(number.as_f64()?),
        Json::String(text) => Value::Text(text.into()),
        Json::Array(items) if items.iter().all(Json::is_number) => {
            Value::Numbers(items.iter().filter_map(Json::as_f64).collect())
        }
        Json::Array(items) => Value::List(items.into_iter().filter_map(convert).collect()),
        Json::Object(fields) => Value::Message(
            fields.into_iter().filter_map(|(name, value)| Some((name.into(), convert(value)?))).collect(),
        ),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use super::*;

    #[test]
    fn reads_fields_arrays_and_stamp() {
        let text = br#"{"timestamp":{"sec":3,"nsec":4},"q":[1,2.5],"on":true,"who":"me","gone":null}"#;
        let value = decode(text).unwrap();
        assert_eq!(value.stamp(), Some(3_000_000_004));
        assert_eq!(value.field("q"), Some(&Value::Numbers(vec![1.0, 2.5])));
        assert_eq!(value.number("on"), Some(1.0));
        assert_eq!(value.text("who"), Some("me"));
        assert_eq!(value.field("gone"), None);
    }

    #[test]
    fn refuses_what_is_not_json() {
        assert!(decode(b"{").unwrap_err().contains("not JSON"));
        assert!(decode("[".repeat(10_000).as_bytes()).is_err());
    }
}
