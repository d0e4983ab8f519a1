//! One request and its answer as tensors.

use std::collections::BTreeMap;

use bytes::Bytes;
use gleaner_core::remote::RemotePolicy;
use gleaner_proto::inference::{
    InferParameter, ModelInferRequest, ModelInferResponse,
    infer_parameter::ParameterChoice,
    model_infer_request::{InferInputTensor, InferRequestedOutputTensor},
};

use super::{
    Sequence,
    metadata::{Form, Tensors},
};
use crate::{fault::shown, inputs::Value};

/// The request for an observation.
pub(super) fn request(
    policy: &RemotePolicy,
    values: Vec<(&str, Value<'_>)>,
    sequence: Option<Sequence>,
    tensors: &Tensors,
) -> ModelInferRequest {
    let mut request = ModelInferRequest {
        model_name: policy.model.clone(),
        model_version: policy.model_version.clone(),
        outputs: vec![InferRequestedOutputTensor { name: policy.output.clone(), parameters: BTreeMap::new() }],
        parameters: sequence.map(parameters).unwrap_or_default(),
        ..ModelInferRequest::default()
    };
    for (name, value) in values {
        let form = tensors.form(name);
        let (datatype, shape, data) = raw(value, form);
        let batch = form.batch.then_some(1);
        let shape = shape.into_iter().map(|size| i64::try_from(size).unwrap_or(i64::MAX));
        request.inputs.push(InferInputTensor {
            name: name.to_owned(),
            datatype: datatype.to_owned(),
            shape: batch.into_iter().chain(shape).collect(),
            ..InferInputTensor::default()
        });
        request.raw_input_contents.push(data);
    }
    request
}

fn parameters(sequence: Sequence) -> BTreeMap<String, InferParameter> {
    let Sequence { id, start, end } = sequence;
    let parameter = |name: &str, choice| (name.to_owned(), InferParameter { parameter_choice: Some(choice) });
    BTreeMap::from([
        parameter("sequence_id", ParameterChoice::Int64Param(id)),
        parameter("sequence_start", ParameterChoice::BoolParam(start)),
        parameter("sequence_end", ParameterChoice::BoolParam(end)),
    ])
}

/// The datatype, shape and bytes of a value.
fn raw(value: Value<'_>, form: Form) -> (&'static str, Vec<usize>, Bytes) {
    match value {
        Value::Bytes(shape, data) => ("UINT8", shape.to_vec(), data.into_owned().into()),
        Value::Words(shape, data) => ("UINT16", shape.to_vec(), Bytes::copy_from_slice(data)),
        Value::Numbers(numbers) if form.wide => {
            let data = numbers.iter().flat_map(|number| f64::from(*number).to_le_bytes()).collect();
            ("FP64", vec![numbers.len()], data)
        }
        Value::Numbers(numbers) => {
            let data = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
            ("FP32", vec![numbers.len()], data)
        }
        Value::Text(text) => {
            let length = u32::try_from(text.len()).unwrap_or(u32::MAX).to_le_bytes();
            ("BYTES", vec![1], length.into_iter().chain(text.bytes()).collect())
        }
    }
}

/// The shape and values of the output of this name.
///
/// # Errors
/// What is wrong, to follow the name of the server.
pub(super) fn output(answer: ModelInferResponse, name: &str) -> Result<(Vec<usize>, Vec<f32>), String> {
    let ModelInferResponse { outputs, raw_output_contents, .. } = answer;
    let Some(index) = outputs.iter().position(|output| output.name == name) else {
        let has: Vec<String> = outputs.iter().take(16).map(|output| shown(&output.name)).collect();
        return Err(format!("its answer has no output {name}; it has {}", has.join(", ")));
    };
    let output = &outputs[index];
    let sizes = output.shape.iter().map(|&size| usize::try_from(size));
    let shape = sizes.collect::<Result<Vec<_>, _>>().map_err(|_| format!("{name} has a shape below 0"))?;
    let raw = raw_output_contents.get(index);
    let values = match (output.datatype.as_str(), raw, &output.contents) {
        ("FP32", Some(raw), _) => numbers(raw, f32::from_le_bytes),
        ("FP64", Some(raw), _) => numbers(raw, |bytes| narrow(f64::from_le_bytes(bytes))),
        ("FP32", None, Some(contents)) => Some(contents.fp32_contents.clone()),
        ("FP64", None, Some(contents)) => Some(contents.fp64_contents.iter().copied().map(narrow).collect()),
        ("FP32" | "FP64", None, None) => return Err(format!("{name} has no values")),
        (other, _, _) => return Err(format!("{name} has datatype {}, must be FP32 or FP64", shown(other))),
    };
    let values = values.ok_or_else(|| format!("{name} has bytes that are not whole numbers of its datatype"))?;
    Ok((shape, values))
}

fn numbers<const N: usize>(raw: &[u8], number: impl Fn([u8; N]) -> f32) -> Option<Vec<f32>> {
    let (whole, rest) = raw.as_chunks::<N>();
    rest.is_empty().then(|| whole.iter().map(|bytes| number(*bytes)).collect())
}

#[expect(clippy::cast_possible_truncation, reason = "policies compute in 32-bit numbers; infinite ones are refused")]
fn narrow(number: f64) -> f32 {
    number as f32
}

#[cfg(test)]
mod tests {
    use gleaner_core::remote::Protocol;
    use gleaner_proto::inference::{InferTensorContents, model_infer_response::InferOutputTensor};

    use super::*;
    use crate::inputs::tests::policy;

    fn answer(datatype: &str, shape: &[i64], raw: Option<Vec<u8>>) -> ModelInferResponse {
        let output = InferOutputTensor {
            name: "action".into(),
            datatype: datatype.into(),
            shape: shape.to_vec(),
            ..Default::default()
        };
        ModelInferResponse {
            outputs: vec![output],
            raw_output_contents: raw.into_iter().collect(),
            ..Default::default()
        }
    }

    #[test]
    fn outputs_of_both_widths_are_read() {
        let four = |raw: Vec<u8>, datatype: &str| output(answer(datatype, &[1, 2], Some(raw)), "action").unwrap();
        let bytes: Vec<u8> = [1.5_f32, -2.0].iter().flat_map(|value| value.to_le_bytes()).collect();
        assert_eq!(four(bytes, "FP32"), (vec![1, 2], vec![1.5, -2.0]));
        let bytes: Vec<u8> = [1.5_f64, 1e300].iter().flat_map(|value| value.to_le_bytes()).collect();
        assert_eq!(four(bytes, "FP64"), (vec![1, 2], vec![1.5, f32::INFINITY]));
        let mut typed = answer("FP32", &[1], None);
        typed.outputs[0].contents = Some(InferTensorContents { fp32_contents: vec![3.0], ..Default::default() });
        assert_eq!(output(typed, "action").unwrap(), (vec![1], vec![3.0]));
    }

    #[test]
    fn other_outputs_are_refused() {
        for (given, words) in [
            (ModelInferResponse::default(), "no output action"),
            (answer("FP32", &[1], None), "action has no values"),
            (answer("FP32", &[1], Some(vec![0; 5])), "not whole numbers"),
            (answer("FP16", &[1], Some(vec![0; 2])), "datatype FP16"),
            (answer("FP32", &[-1], Some(vec![0; 4])), "shape below 0"),
        ] {
            let problem = output(given, "action").unwrap_err();
            assert!(problem.contains(words), "{words} expected: {problem}");
        }
    }

    #[test]
    fn values_are_sent_raw_in_the_form_of_the_model() {
        let policy = policy(Protocol::OpenInference, "http://a:1", Vec::new());
        let values = vec![
            ("image", Value::Bytes([1, 1, 3], vec![1, 2, 3].into())),
            ("prompt", Value::Text("pick")),
            ("state", Value::Numbers(vec![1.0].into())),
        ];
        let sequence = Some(Sequence { id: 7, start: true, end: false });
        let request = request(&policy, values, sequence, &Tensors::default());
        let forms: Vec<(&str, &str, &[i64])> = request
            .inputs
            .iter()
            .map(|input| (input.name.as_str(), input.datatype.as_str(), input.shape.as_slice()))
            .collect();
        assert_eq!(forms, [("image", "UINT8", &[1, 1, 3][..]), ("prompt", "BYTES", &[1]), ("state", "FP32", &[1])]);
        assert_eq!(request.raw_input_contents[1], b"\x04\0\0\0pick"[..]);
        let start = &request.parameters["sequence_start"].parameter_choice;
        assert_eq!(*start, Some(ParameterChoice::BoolParam(true)));
        assert_eq!((request.model_name.as_str(), request.outputs[0].name.as_str()), ("arm", "action"));
    }
}
