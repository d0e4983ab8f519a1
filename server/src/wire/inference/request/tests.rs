//! Requests that are right in every form, and each mistake by name.

use gleaner_learn::{CameraShape, TaskShape};
use gleaner_proto::inference::{InferParameter, InferTensorContents, infer_parameter::ParameterChoice};

use super::*;
use crate::{domain::observation::ImageFormat, error::Kind};

/// Two cameras, one with depth; two values of proprioception, one of action.
fn tensors() -> Tensors {
    let camera = |name: &str, depth| CameraShape { name: name.into(), height: 2, width: 3, depth, recorded: None };
    let cameras = vec![camera("top", true), camera("wrist", false)];
    Tensors::of(&TaskShape {
        cameras,
        proprioception: 2,
        action: 1,
        ranges: gleaner_core::action::ActionRanges::default(),
    })
    .unwrap()
}

fn input(name: &str, datatype: &str, shape: &[i64]) -> InferInputTensor {
    InferInputTensor { name: name.into(), datatype: datatype.into(), shape: shape.to_vec(), ..Default::default() }
}

fn floats(values: &[f32]) -> Bytes {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// A right request, raw; its tensors come in another order than the task's.
fn raw() -> ModelInferRequest {
    ModelInferRequest {
        model_name: "arm".into(),
        id: "7".into(),
        inputs: vec![
            input("proprioception", "FP32", &[2]),
            input("wrist", "UINT8", &[1, 2, 3, 3]),
            input("top.depth", "UINT16", &[2, 3]),
            input("top", "UINT8", &[2, 3, 3]),
        ],
        raw_input_contents: vec![floats(&[0.5, -0.5]), vec![9; 18].into(), [1, 2].repeat(6).into(), vec![3; 18].into()],
        ..Default::default()
    }
}

/// The same, each value in its own contents, and with the executed action.
fn typed() -> ModelInferRequest {
    let mut request = raw();
    request.raw_input_contents.clear();
    request.inputs.push(input("executed_action", "FP32", &[1, 1]));
    let uint = |values| InferTensorContents { uint_contents: values, ..Default::default() };
    let fp32 = |values| InferTensorContents { fp32_contents: values, ..Default::default() };
    let contents = [fp32(vec![0.5, -0.5]), uint(vec![9; 18]), uint(vec![513; 6]), uint(vec![3; 18]), fp32(vec![0.25])];
    for (input, contents) in request.inputs.iter_mut().zip(contents) {
        input.contents = Some(Box::new(contents));
    }
    request
}

fn read(sent: ModelInferRequest) -> Result<Observation> {
    observation(&tensors(), request(sent)?.inputs)
}

#[test]
fn raw_and_typed_tensors_are_the_same_observation() {
    for (sent, executed) in [(raw(), vec![]), (typed(), vec![0.25])] {
        let read = read(sent).unwrap();
        let [top, wrist] = read.cameras.as_slice() else { panic!("two cameras") };
        let image = |image: &Option<crate::domain::observation::Image>| {
            let image = image.clone().unwrap();
            assert_eq!(image.format, ImageFormat::Raw);
            image.data.to_vec()
        };
        assert_eq!((top.camera.as_str(), image(&top.color), image(&top.depth)), ("top", vec![3; 18], [1, 2].repeat(6)));
        assert_eq!((wrist.camera.as_str(), image(&wrist.color)), ("wrist", vec![9; 18]));
        assert!(wrist.depth.is_none());
        assert_eq!((read.proprioception, read.executed_action), (vec![0.5, -0.5], executed));
    }
}

#[test]
fn an_encoded_image_is_one_element_of_bytes() {
    let mut sent = raw();
    sent.inputs[1] = input("wrist", "BYTES", &[1]);
    sent.raw_input_contents[1] = [&3u32.to_le_bytes()[..], b"jpg"].concat().into();
    let image = read(sent.clone()).unwrap().cameras[1].color.clone().unwrap();
    assert_eq!((image.format, image.data.as_ref()), (ImageFormat::Any, &b"jpg"[..]));
    for broken in [b"".to_vec(), vec![0, 0, 0], [&4u32.to_le_bytes()[..], b"jpg"].concat(), vec![255; 8]] {
        sent.raw_input_contents[1] = broken.into();
        let error = read(sent.clone()).unwrap_err();
        assert!(error.message().starts_with("inputs.wrist: "), "{error}");
    }

    let mut sent = typed();
    sent.inputs[1] = input("wrist", "BYTES", &[1, 1]);
    let bytes = |elements: &[&'static [u8]]| {
        let bytes_contents = elements.iter().map(|&element| Bytes::from_static(element)).collect();
        Some(Box::new(InferTensorContents { bytes_contents, ..Default::default() }))
    };
    sent.inputs[1].contents = bytes(&[b"png"]);
    let image = read(sent.clone()).unwrap().cameras[1].color.clone().unwrap();
    assert_eq!(image.data.as_ref(), b"png");
    sent.inputs[1].contents = bytes(&[b"png", b"png"]);
    assert!(read(sent).unwrap_err().message().starts_with("inputs.wrist: has 2 values"));
}

type Spoil = fn(&mut ModelInferRequest);

fn every_one_is_named(right: fn() -> ModelInferRequest, cases: &[(&str, Spoil)]) {
    for (start, spoil) in cases {
        let mut sent = right();
        spoil(&mut sent);
        let error = read(sent).unwrap_err();
        assert_eq!(error.kind(), Kind::Invalid, "{error}");
        assert!(error.message().starts_with(start), "{start} expected: {error}");
        assert!(error.message().len() < 400, "{error}");
    }
}

#[test]
fn every_mistake_in_raw_tensors_is_named() {
    every_one_is_named(
        raw,
        &[
            ("model_name: ", |r| r.model_name = "../x".into()),
            ("model_version: ", |r| r.model_version = "1".into()),
            ("raw_input_contents: ", |r| r.raw_input_contents.truncate(3)),
            ("raw_input_contents: ", |r| r.raw_input_contents.push(Bytes::new())),
            ("inputs[3].name: ", |r| r.inputs[3].name = "left".repeat(1000)),
            ("inputs[3].name: ", |r| r.inputs[3].name = "wrist".into()),
            ("inputs.top: is missing", |r| {
                r.inputs.pop();
                r.raw_input_contents.pop();
            }),
            ("inputs.proprioception: has datatype \"FP64\"", |r| r.inputs[0].datatype = "FP64".into()),
            ("inputs.proprioception: has datatype \"BYTES\"", |r| r.inputs[0].datatype = "BYTES".into()),
            ("inputs.wrist: has datatype \"UINT16\"", |r| r.inputs[1].datatype = "UINT16".into()),
            ("inputs.top.depth: has datatype \"UINT8\"", |r| r.inputs[2].datatype = "UINT8".into()),
            ("inputs.wrist: has shape [3, 2, 3]", |r| r.inputs[1].shape = vec![3, 2, 3]),
            ("inputs.wrist: has shape [2, 2, 3, 3]", |r| r.inputs[1].shape[0] = 2),
            ("inputs.wrist: has shape []", |r| r.inputs[1].shape.clear()),
            ("inputs.wrist: has shape [-1, ", |r| r.inputs[1].shape = vec![-1; 100_000]),
            ("inputs.top.depth: has shape [2, 3, 1]", |r| r.inputs[2].shape.push(1)),
            ("inputs.wrist: has shape [2]", |r| (r.inputs[1].datatype, r.inputs[1].shape) = ("BYTES".into(), vec![2])),
            ("inputs.wrist: has 17 bytes", |r| r.raw_input_contents[1] = vec![9; 17].into()),
            ("inputs.top.depth: has 6 bytes", |r| r.raw_input_contents[2] = vec![9; 6].into()),
            ("inputs.proprioception: has 12 bytes", |r| r.raw_input_contents[0] = floats(&[0.0; 3])),
            ("inputs.\"top\": has both", |r| {
                r.inputs[3].contents = typed().inputs.swap_remove(3).contents;
            }),
            ("inputs.\"wrist\": has the parameter", |r| {
                let choice = ParameterChoice::StringParam("region".into());
                let region = InferParameter { parameter_choice: Some(choice) };
                r.inputs[1].parameters.insert("shared_memory_region".into(), region);
            }),
            ("inputs: are 1000000", |r| {
                r.inputs = vec![InferInputTensor::default(); 1_000_000];
                r.raw_input_contents.clear();
            }),
            ("outputs[0].name: ", |r| r.outputs.push(wanted("actions"))),
            ("outputs[1].name: ", |r| r.outputs = vec![wanted(ACTION), wanted(ACTION)]),
            ("outputs[0].parameters: ", |r| {
                r.outputs.push(wanted(ACTION));
                r.outputs[0].parameters.insert("classification".into(), InferParameter::default());
            }),
        ],
    );
    let mut fine = raw();
    fine.outputs.push(wanted(ACTION));
    assert!(read(fine).is_ok());
}

#[test]
fn every_mistake_in_typed_tensors_is_named() {
    every_one_is_named(
        typed,
        &[
            ("inputs.\"wrist\": has no values", |r| r.inputs[1].contents = None),
            ("inputs.wrist: has 0 values", |r| r.inputs[1].contents = Some(Box::default())),
            ("inputs.wrist: has 17 values", |r| contents(r, 1).uint_contents.truncate(17)),
            ("inputs.wrist[4]: is 256", |r| contents(r, 1).uint_contents[4] = 256),
            ("inputs.top.depth[5]: is 65536", |r| contents(r, 2).uint_contents[5] = 65536),
            ("inputs.wrist: has values in int_contents", |r| contents(r, 1).int_contents = vec![1; 18]),
            ("inputs.proprioception: has values in fp64_contents", |r| contents(r, 0).fp64_contents.push(1.0)),
            ("inputs.proprioception: has 1 values", |r| contents(r, 0).fp32_contents.truncate(1)),
            ("inputs.executed_action: has 2 values", |r| contents(r, 4).fp32_contents.push(1.0)),
        ],
    );
}

/// Two bytes of a message are an empty tensor, so its size is what a message may swell by.
#[test]
fn an_empty_tensor_is_small() {
    assert!(size_of::<InferInputTensor>() <= 112, "{}", size_of::<InferInputTensor>());
}

#[test]
fn tensors_that_would_share_a_name_are_refused() {
    let camera = |name: &str, depth| CameraShape { name: name.into(), height: 8, width: 8, depth, recorded: None };
    for cameras in [vec![camera("proprioception", false)], vec![camera("top", true), camera("top.depth", false)]] {
        let error = Tensors::of(&TaskShape {
            cameras,
            proprioception: 1,
            action: 1,
            ranges: gleaner_core::action::ActionRanges::default(),
        })
        .unwrap_err();
        assert_eq!(error.kind(), Kind::Precondition);
    }
}

#[test]
fn errors_about_images_name_their_tensor() {
    let named = |field: &str| tensors().name(Error::invalid(field, "is broken")).message().to_owned();
    assert_eq!(named("inputs.cameras[0].color"), "inputs.top: is broken");
    assert_eq!(named("inputs.cameras[0].depth"), "inputs.top.depth: is broken");
    assert_eq!(named("inputs.cameras[1].color"), "inputs.wrist: is broken");
    assert_eq!(named("inputs.proprioception[1]"), "inputs.proprioception[1]: is broken");
}

fn wanted(name: &str) -> InferRequestedOutputTensor {
    InferRequestedOutputTensor { name: name.into(), ..Default::default() }
}

fn contents(request: &mut ModelInferRequest, index: usize) -> &mut InferTensorContents {
    request.inputs[index].contents.as_mut().unwrap()
}
