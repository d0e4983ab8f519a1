//! The description of a model: its tensors compared with what a policy sends and reads.

use std::collections::HashMap;

use gleaner_proto::inference::{ModelMetadataResponse, model_metadata_response::TensorMetadata};

use crate::{actions::Actions, fault::shown, inputs::Value};

/// What is known of the tensors of a model; nothing of a server that does not describe it.
#[derive(Debug, Clone, Default)]
pub(super) struct Tensors(HashMap<String, Form>);

/// The form in which a tensor is sent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Form {
    /// Whether a dimension of batches leads.
    pub(super) batch: bool,
    /// Whether numbers have 64 bits.
    pub(super) wide: bool,
}

impl Tensors {
    /// The form of a tensor.
    pub(super) fn form(&self, name: &str) -> Form {
        self.0.get(name).copied().unwrap_or_default()
    }

    /// Compares a description with the values that are sent and the output that is read.
    ///
    /// # Errors
    /// What does not fit, to follow the name of the server.
    pub(super) fn read(
        model: ModelMetadataResponse,
        sent: &[(&str, Value<'_>)],
        actions: &Actions,
    ) -> Result<Self, String> {
        let ModelMetadataResponse { name, versions: _, platform: _, inputs, outputs } = model;
        let listed = |tensors: &[TensorMetadata]| {
            let names: Vec<String> = tensors.iter().take(16).map(|tensor| shown(&tensor.name)).collect();
            names.join(", ")
        };
        let mut forms = HashMap::new();
        if !inputs.is_empty() {
            for (input, value) in sent {
                let Some(tensor) = inputs.iter().find(|tensor| tensor.name == *input) else {
                    let has = listed(&inputs);
                    return Err(format!("model {} has no input {input}; it has {has}", shown(&name)));
                };
                forms.insert((*input).to_owned(), form(tensor, value)?);
            }
        }
        match outputs.iter().find(|tensor| tensor.name == actions.output) {
            None if !outputs.is_empty() => {
                Err(format!("model {} has no output {}; it has {}", shown(&name), actions.output, listed(&outputs)))
            }
            Some(output) if !matches!(output.datatype.as_str(), "FP32" | "FP64") => {
                Err(format!("output {} has datatype {}, must be FP32 or FP64", actions.output, shown(&output.datatype)))
            }
            Some(_) | None => Ok(Self(forms)),
        }
    }
}

/// The form of one tensor for a value.
fn form(tensor: &TensorMetadata, value: &Value<'_>) -> Result<Form, String> {
    let TensorMetadata { name, datatype, shape } = tensor;
    let (datatypes, expected): (&[&str], Vec<usize>) = match value {
        Value::Bytes(shape, _) => (&["UINT8"], shape.to_vec()),
        Value::Words(shape, _) => (&["UINT16"], shape.to_vec()),
        Value::Numbers(numbers) => (&["FP32", "FP64"], vec![numbers.len()]),
        Value::Text(_) => (&["BYTES"], vec![1]),
    };
    if !datatypes.contains(&datatype.as_str()) {
        let (datatype, known) = (shown(datatype), datatypes.join(" or "));
        return Err(format!("input {} has datatype {datatype}, this server sends {known}", shown(name)));
    }
    let fits = |shape: &[i64]| {
        let same = |(&found, &own): (&i64, &usize)| found < 0 || usize::try_from(found).is_ok_and(|found| found == own);
        shape.len() == expected.len() && shape.iter().zip(&expected).all(same)
    };
    let batch = match shape.split_first() {
        _ if fits(shape) => false,
        Some((&batch, rest)) if (batch < 0 || batch == 1) && fits(rest) => true,
        Some(_) | None => {
            let found = &shape[..shape.len().min(8)];
            return Err(format!("input {} has shape {found:?}, this server sends {expected:?}", shown(name)));
        }
    };
    Ok(Form { batch, wide: datatype == "FP64" })
}

#[cfg(test)]
mod tests {
    use gleaner_core::remote::Protocol;

    use super::*;
    use crate::inputs::tests::{policy, task};

    fn tensor(name: &str, datatype: &str, shape: &[i64]) -> TensorMetadata {
        TensorMetadata { name: name.into(), datatype: datatype.into(), shape: shape.to_vec() }
    }

    fn read(inputs: Vec<TensorMetadata>, outputs: Vec<TensorMetadata>) -> Result<Tensors, String> {
        let actions = Actions::of(&policy(Protocol::OpenInference, "http://a:1", Vec::new()), &task());
        let pixels = vec![0; 6];
        let sent = [("image", Value::Bytes([1, 2, 3], pixels.into())), ("state", Value::Numbers(vec![0.0; 3].into()))];
        Tensors::read(ModelMetadataResponse { inputs, outputs, ..Default::default() }, &sent, &actions)
    }

    #[test]
    fn a_leading_batch_and_wide_numbers_are_followed() {
        let tensors =
            read(vec![tensor("image", "UINT8", &[-1, 1, 2, 3]), tensor("state", "FP64", &[3])], Vec::new()).unwrap();
        assert_eq!(tensors.form("image"), Form { batch: true, wide: false });
        assert_eq!(tensors.form("state"), Form { batch: false, wide: true });
        let any =
            read(vec![tensor("image", "UINT8", &[-1, -1, 3]), tensor("state", "FP32", &[1, 3])], Vec::new()).unwrap();
        assert_eq!((any.form("image").batch, any.form("state").batch), (false, true));
        assert_eq!(read(Vec::new(), Vec::new()).unwrap().form("state"), Form::default(), "nothing is described");
    }

    #[test]
    fn a_model_with_other_tensors_is_refused() {
        let image = || tensor("image", "UINT8", &[1, 2, 3]);
        let state = || tensor("state", "FP32", &[3]);
        for (inputs, outputs, words) in [
            (vec![image()], vec![], "has no input state; it has image"),
            (vec![image(), tensor("state", "INT32", &[3])], vec![], "input state has datatype INT32"),
            (vec![image(), tensor("state", "FP32", &[4])], vec![], "input state has shape [4], this server sends [3]"),
            (vec![tensor("image", "UINT8", &[3, 1, 2]), state()], vec![], "input image has shape [3, 1, 2]"),
            (vec![tensor("image", "FP32", &[1, 2, 3]), state()], vec![], "input image has datatype FP32"),
            (vec![tensor("image", "UINT8", &[]), state()], vec![], "input image has shape []"),
            (vec![image(), state()], vec![tensor("a\u{1b}", "FP32", &[1])], "has no output action; it has a\\u{1b}"),
            (vec![image(), state()], vec![tensor("action", "BYTES", &[1])], "output action has datatype BYTES"),
        ] {
            let problem = read(inputs, outputs).unwrap_err();
            assert!(problem.contains(words), "{words} expected: {problem}");
        }
    }
}
