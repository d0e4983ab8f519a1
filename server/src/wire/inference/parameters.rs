//! A request's parameters: its sequence.

use std::collections::BTreeMap;

use gleaner_proto::inference::{InferParameter, infer_parameter::ParameterChoice};

use super::quoted;
use crate::{
    domain::sequence::{Place, SequenceId},
    error::{Error, Result},
};

const ID: &str = "sequence_id";
const START: &str = "sequence_start";
const END: &str = "sequence_end";
const ID_BYTES: usize = 128;

/// The sequence of a request; `None` for a single request.
///
/// # Errors
/// Invalid, naming the parameter; also for an unknown one, which would otherwise have no effect.
pub(super) fn place(mut parameters: BTreeMap<String, InferParameter>) -> Result<Option<Place>> {
    let id = parameters.remove(ID).map(sequence_id).transpose()?.flatten();
    let start = flag(START, parameters.remove(START))?;
    let end = flag(END, parameters.remove(END))?;
    // The first by name, so that equal requests have equal errors.
    if let Some(unknown) = parameters.keys().min() {
        return Err(Error::invalid(
            "parameters",
            format!("{} is unknown; supported: {ID}, {START}, {END}", quoted(unknown)),
        ));
    }
    match id {
        Some(id) => Ok(Some(Place { id, start, end })),
        None if start || end => {
            Err(Error::invalid(&field(ID), format!("must be set, and not 0 or empty, for {START} and {END}")))
        }
        None => Ok(None),
    }
}

fn sequence_id(parameter: InferParameter) -> Result<Option<SequenceId>> {
    let InferParameter { parameter_choice } = parameter;
    let wrong = |fix: &str| Err(Error::invalid(&field(ID), fix));
    let id = match parameter_choice {
        Some(ParameterChoice::Int64Param(number)) => match u64::try_from(number) {
            Ok(number) => SequenceId::Number(number),
            Err(_) => return wrong("must not be below 0"),
        },
        Some(ParameterChoice::Uint64Param(number)) => SequenceId::Number(number),
        Some(ParameterChoice::StringParam(text)) => SequenceId::Text(text),
        Some(ParameterChoice::BoolParam(_) | ParameterChoice::DoubleParam(_)) | None => {
            return wrong("must be an integer or a text");
        }
    };
    match id {
        SequenceId::Number(0) => Ok(None),
        SequenceId::Text(text) if text.is_empty() => Ok(None),
        SequenceId::Text(text) if text.len() > ID_BYTES => wrong(&format!("must be at most {ID_BYTES} bytes")),
        id @ (SequenceId::Number(_) | SequenceId::Text(_)) => Ok(Some(id)),
    }
}

fn flag(name: &str, parameter: Option<InferParameter>) -> Result<bool> {
    match parameter.map(|InferParameter { parameter_choice }| parameter_choice) {
        None => Ok(false),
        Some(Some(ParameterChoice::BoolParam(value))) => Ok(value),
        Some(_) => Err(Error::invalid(&field(name), "must be a bool")),
    }
}

fn field(name: &str) -> String {
    format!("parameters.{name}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed<const N: usize>(parameters: [(&str, ParameterChoice); N]) -> Result<Option<Place>> {
        let wrap = |(name, choice): (&str, _)| (name.to_owned(), InferParameter { parameter_choice: Some(choice) });
        place(parameters.into_iter().map(wrap).collect())
    }

    #[test]
    fn a_sequence_is_a_number_or_a_text() {
        use ParameterChoice::*;
        let number = Place { id: SequenceId::Number(7), start: false, end: false };
        assert_eq!(parsed([(ID, Int64Param(7))]).unwrap(), Some(number.clone()));
        assert_eq!(parsed([(ID, Uint64Param(7))]).unwrap(), Some(number));
        let text = Place { id: SequenceId::Text("7".into()), start: true, end: true };
        let sent = [(ID, StringParam("7".into())), (START, BoolParam(true)), (END, BoolParam(true))];
        assert_eq!(parsed(sent).unwrap(), Some(text));
        for none in [Int64Param(0), Uint64Param(0), StringParam(String::new())] {
            assert_eq!(parsed([(ID, none), (START, BoolParam(false))]).unwrap(), None);
        }
        assert_eq!(parsed([]).unwrap(), None);
    }

    #[test]
    fn a_wrong_parameter_is_named() {
        use ParameterChoice::*;
        let cases = [
            ("parameters.sequence_id: ", parsed([(ID, Int64Param(-1))])),
            ("parameters.sequence_id: ", parsed([(ID, BoolParam(true))])),
            ("parameters.sequence_id: ", parsed([(ID, StringParam("x".repeat(129)))])),
            ("parameters.sequence_id: ", parsed([(START, BoolParam(true))])),
            ("parameters.sequence_id: ", parsed([(ID, Int64Param(0)), (END, BoolParam(true))])),
            ("parameters.sequence_start: ", parsed([(ID, Int64Param(1)), (START, Int64Param(1))])),
            ("parameters.sequence_end: ", parsed([(ID, Int64Param(1)), (END, StringParam("true".into()))])),
            ("parameters: \"priority\"", parsed([("priority", Uint64Param(1)), ("timeout", Int64Param(1))])),
        ];
        for (start, result) in cases {
            let error = result.unwrap_err();
            assert!(error.message().starts_with(start), "{start} expected: {error}");
        }
        let empty = BTreeMap::from([(ID.to_owned(), InferParameter { parameter_choice: None })]);
        assert!(place(empty).unwrap_err().message().starts_with("parameters.sequence_id: "));
    }
}
