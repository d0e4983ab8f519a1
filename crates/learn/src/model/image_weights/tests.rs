//! Files that are taken, and files that are refused with everything that is wrong with them.

use tch::nn::VarStore;
use tch::{Device, Kind};

use super::made::{Tensors, file, tensors};
use super::*;
use crate::batch::values;
use crate::model::image_encoder::ImageEncoder as Encoder;
use crate::model::weights;
use crate::toy;
use gleaner_core::ModelSpec;

const RESNET_18: ImageEncoder = ImageEncoder::Resnet18;

/// The parameters of an encoder with two cameras, the second with depth.
fn parameters(image_encoder: ImageEncoder) -> (VarStore, Vec<(String, Tensor)>) {
    let mut shape = toy::shape();
    let mut colour = shape.cameras[0].clone();
    (colour.name, colour.depth) = ("side".into(), false);
    shape.cameras.insert(0, colour);
    let store = VarStore::new(Device::Cpu);
    let _ = Encoder::new(&(store.root() / "image"), &shape, &ModelSpec { image_encoder, ..ModelSpec::default() });
    let parameters = weights::sorted(&store);
    (store, parameters)
}

fn refusal(bytes: Option<&[u8]>, image_encoder: ImageEncoder) -> String {
    let (_store, parameters) = parameters(image_encoder);
    give(image_encoder, &parameters, bytes).unwrap_err().to_string()
}

/// The refusal of the tensors of ResNet-18 after a change.
fn changed(change: impl FnOnce(&mut Tensors)) -> String {
    let mut tensors = tensors(RESNET_18);
    change(&mut tensors);
    refusal(Some(&file(&tensors)), RESNET_18)
}

#[test]
fn each_camera_has_a_copy_of_its_own_and_depth_begins_at_zero() {
    let (_store, parameters) = parameters(RESNET_18);
    let made = tensors(RESNET_18);
    give(RESNET_18, &parameters, Some(&file(&made))).unwrap();
    let mut found = 0;
    for (name, parameter) in &parameters {
        let Some((camera, short)) = name.split_once(".resnet.") else { continue };
        let (_, expected) = &made[short];
        let colours = if short == FIRST { parameter.narrow(1, 0, COLOURS) } else { parameter.shallow_clone() };
        assert_eq!(&values(&colours.contiguous()), expected, "{name}");
        if short == FIRST && camera == "image.camera.1" {
            assert_eq!(parameter.size(), [64, 4, 7, 7]);
            assert_eq!(parameter.narrow(1, 3, 1).abs().sum(Kind::Float).double_value(&[]), 0.0);
        }
        found += 1;
    }
    assert_eq!(found, 2 * made.len());
    let first =
        |camera: &str| &parameters.iter().find(|(name, _)| *name == format!("{camera}.resnet.bn1.bias")).unwrap().1;
    let _ = first("image.camera.0").shallow_clone().zero_();
    assert_ne!(values(first("image.camera.0")), values(first("image.camera.1")));
}

#[test]
fn the_classifier_and_counters_are_ignored() {
    let mut tensors = tensors(RESNET_18);
    tensors.insert("fc.weight".into(), (vec![2, 1], vec![f32::NAN, 1.0]));
    tensors.insert("layer1.0.bn1.num_batches_tracked".into(), (vec![], vec![7.0]));
    let (_store, parameters) = parameters(RESNET_18);
    assert!(give(RESNET_18, &parameters, Some(&file(&tensors))).is_ok());
}

#[test]
fn one_message_has_every_fault() {
    let message = changed(|tensors| {
        let kernel = tensors.remove("layer1.0.conv1.weight").unwrap();
        tensors.insert("layer1.0.conv_1.weight".into(), kernel);
        tensors.get_mut("conv1.weight").unwrap().0 = vec![64, 3, 49, 1];
        tensors.get_mut("bn1.bias").unwrap().1[5] = f32::NAN;
        tensors.get_mut("layer4.1.conv2.weight").unwrap().1[0] = f32::INFINITY;
        tensors.get_mut("bn1.running_var").unwrap().1[0] = -0.1;
    });
    assert_eq!(
        message,
        "image_weights: the file does not have the weights of this network of torchvision: \
         missing: layer1.0.conv1.weight; \
         of another shape: conv1.weight ([64, 3, 49, 1], expected [64, 3, 7, 7]); \
         unexpected: layer1.0.conv_1.weight; \
         with negative variances: bn1.running_var; \
         with values that are not finite: bn1.bias, layer4.1.conv2.weight"
    );
}

#[test]
fn a_network_of_another_depth_is_refused_with_a_few_names() {
    let message = refusal(Some(&file(&tensors(RESNET_18))), ImageEncoder::Resnet34);
    assert!(message.contains("missing: layer1.2.bn1.bias, ") && message.contains(" and 75 more"), "{message}");
    assert!(!message.contains("unexpected"), "{message}");
    let message = refusal(Some(&file(&tensors(ImageEncoder::Resnet34))), RESNET_18);
    assert!(message.contains("unexpected: layer1.2.bn1.bias, ") && !message.contains("missing"), "{message}");
}

#[test]
fn a_file_that_is_not_whole_is_refused() {
    let bytes = file(&tensors(RESNET_18));
    for damaged in [&bytes[..bytes.len() - 1], &bytes[..100], b"PK\x03\x04 a .pth file", b""] {
        let message = refusal(Some(damaged), RESNET_18);
        assert!(message.starts_with("image_weights: the file is not a whole safetensors file ("), "{message}");
        assert!(message.contains("convert a .pth file with scripts/convert_resnet.py"), "{message}");
    }
}

#[test]
fn tensors_of_another_type_are_refused() {
    let bytes = file(&tensors(RESNET_18));
    // Of the same length, so that the rest of the file stays as it is.
    let at = bytes.windows(5).position(|part| part == b"\"F32\"").unwrap();
    let mut other = bytes;
    other[at..at + 5].copy_from_slice(b"\"I32\"");
    assert!(refusal(Some(&other), RESNET_18).contains("not F32: "));
}

#[test]
fn weights_and_image_encoder_belong_together() {
    let bytes = file(&tensors(RESNET_18));
    let message = refusal(Some(&bytes), ImageEncoder::Residual);
    assert_eq!(message, "image_weights: has no effect: image_encoder residual begins with drawn weights; leave it out");
    assert_eq!(refusal(None, RESNET_18), "image_weights: is missing; image_encoder resnet18 begins with given weights");
    let message = give(RESNET_18, &[], Some(&bytes)).unwrap_err().to_string();
    assert!(message.starts_with("image_weights: has no effect: no camera"), "{message}");
}
