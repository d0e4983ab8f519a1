//! Settings on the wire: a map of settings as `google.protobuf.Struct`, and back.

use prost_types::value::Kind;
use prost_types::{ListValue, Struct, Value as Wire};
use serde_json::{Number, Value};

use crate::schema::Values;

/// Settings as a message.
#[must_use]
pub fn to_struct(values: &Values) -> Struct {
    Struct { fields: values.iter().map(|(name, value)| (name.clone(), to_wire(value))).collect() }
}

/// Settings from a message; an unset one is empty. Numbers are doubles on the wire: whole ones become integers again.
#[must_use]
pub fn from_struct(message: Option<Struct>) -> Values {
    message.unwrap_or_default().fields.into_iter().map(|(name, value)| (name, from_wire(value))).collect()
}

fn to_wire(value: &Value) -> Wire {
    let kind = match value {
        Value::Null => Kind::NullValue(0),
        Value::Bool(flag) => Kind::BoolValue(*flag),
        Value::Number(number) => Kind::NumberValue(number.as_f64().unwrap_or(f64::NAN)),
        Value::String(text) => Kind::StringValue(text.clone()),
        Value::Array(values) => Kind::ListValue(ListValue { values: values.iter().map(to_wire).collect() }),
        Value::Object(values) => Kind::StructValue(to_struct(values)),
    };
    Wire { kind: Some(kind) }
}

// The depth of a message is limited where it is decoded.
fn from_wire(value: Wire) -> Value {
    match value.kind {
        None | Some(Kind::NullValue(_)) => Value::Null,
        Some(Kind::BoolValue(flag)) => Value::Bool(flag),
        Some(Kind::NumberValue(number)) => from_number(number),
        Some(Kind::StringValue(text)) => Value::String(text),
        Some(Kind::ListValue(list)) => Value::Array(list.values.into_iter().map(from_wire).collect()),
        Some(Kind::StructValue(message)) => Value::Object(from_struct(Some(message))),
    }
}

/// A number without an exact JSON form (an infinity or not a number) stays visible as text, which no setting accepts.
fn from_number(number: f64) -> Value {
    match Number::from_f64(number) {
        Some(exact) => crate::schema::whole(number).map_or(Value::Number(exact), Value::from),
        None => Value::String(number.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PretrainSpec, ScoreSpec, TrainSpec};

    #[test]
    fn settings_survive_the_wire() {
        let back = |values: &Values| from_struct(Some(to_struct(values)));
        let (pretrain, score, train) = (PretrainSpec::default(), ScoreSpec::default(), TrainSpec::default());
        assert_eq!(PretrainSpec::from_values(&back(&pretrain.values())).unwrap(), pretrain);
        assert_eq!(ScoreSpec::from_values(&back(&score.values())).unwrap(), score);
        assert_eq!(TrainSpec::from_values(&back(&train.values())).unwrap(), train);
        assert_eq!(from_struct(None), Values::new());
    }

    #[test]
    fn numbers_without_a_json_form_are_rejected_by_their_setting() {
        let mut values = Values::new();
        values.insert("learning_rate".to_owned(), from_number(f64::NAN));
        let message = PretrainSpec::from_values(&values).unwrap_err().to_string();
        assert!(message.starts_with("learning_rate: expected a number"), "{message}");
    }
}
