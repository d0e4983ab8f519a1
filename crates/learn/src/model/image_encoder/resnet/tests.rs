//! The network beside torchvision's, whose numbers `reference.py` printed.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]

use gleaner_core::ImageEncoder as Kind;
use tch::nn::VarStore;
use tch::{Device, Tensor};

use super::*;
use crate::model::image_weights::{self, made};
use crate::normalize::{Sample, Statistics};
use crate::shape::{CameraShape, TaskShape};
use crate::trajectory::Trajectory;

const HEIGHT: u32 = 64;
const WIDTH: u32 = 96;

/// Each stage's mean, deviation, channels' mean at the first and at the last place, and mean of channel 7.
type Stages = [[f64; 5]; 4];

const RESNET_18: Stages = [
    [5.4626, 7.14261, 2.58337, 4.50836, 4.37898],
    [10.1532, 13.1453, 5.30423, 9.2822, 22.0386],
    [18.5238, 24.8968, 10.497, 15.5781, 13.1472],
    [27.8222, 36.47, 22.967, 29.083, 3.5204],
];
const RESNET_34: Stages = [
    [10.3704, 10.8122, 4.00041, 5.98481, 8.37277],
    [53.9411, 66.1119, 28.4069, 32.5761, 114.833],
    [533.523, 652.521, 344.118, 388.297, 66.5625],
    [1170.0, 1368.65, 969.514, 1234.97, 2572.51],
];

fn shape(depth: bool) -> TaskShape {
    TaskShape {
        cameras: vec![CameraShape { name: "top".into(), height: HEIGHT, width: WIDTH, depth, recorded: None }],
        proprioception: 1,
        action: 1,
        ranges: gleaner_core::action::ActionRanges::default(),
    }
}

/// One frame, in colour and perhaps with the depth of a name, as the network receives it.
fn standardised(shape: &TaskShape, kind: Kind, depth: &str) -> Tensor {
    let colours = (HEIGHT * WIDTH * 3) as usize;
    let mut frame: Vec<u8> = made::uniform("image", colours).map(|u| (u * 256.0) as u8).collect();
    frame.extend(made::uniform(depth, shape.frame_bytes() - colours).map(|u| (u * 256.0) as u8));
    let data = Trajectory::new(shape, "e", frame.clone(), vec![0.0], vec![0.0]).unwrap();
    let statistics = Statistics::measure(shape, &Sample::every(&[&data]), 8, Device::Cpu).unwrap();
    statistics.for_image_encoder(kind).frames(shape, &[&frame], Device::Cpu).remove(0)
}

/// The outputs of the four stages for a frame with the depth of this name.
fn stages(kind: Kind, depth: Option<&str>) -> Vec<Tensor> {
    let blocks = if kind == Kind::Resnet18 { [2, 2, 2, 2] } else { [3, 4, 6, 3] };
    let (shape, store) = (shape(depth.is_some()), VarStore::new(Device::Cpu));
    let path = &store.root() / "image" / "camera" / 0 / crate::model::image_encoder::RESNET;
    let channels = if depth.is_some() { 4 } else { 3 };
    let (network, size) = network(&path, blocks, [channels, HEIGHT.into(), WIDTH.into()]);
    assert_eq!(size, [512, 2, 3]);
    let parameters = crate::model::weights::sorted(&store);
    crate::model::weights::draw(&parameters, 1.0, 1);
    image_weights::give(kind, &parameters, Some(&made::file(&made::tensors(kind)))).unwrap();
    let every = network.forward_all_t(&standardised(&shape, kind, depth.unwrap_or_default()), false, None);
    // A convolution, its norm and the pooling come first.
    let ends = blocks.iter().scan(2, |last, blocks| {
        *last += blocks;
        Some(*last)
    });
    ends.map(|end| every[end].shallow_clone()).collect()
}

fn summary(x: &Tensor) -> [f64; 5] {
    let x = x.get(0).to_kind(tch::Kind::Double);
    let [height, width] = [x.size()[1] - 1, x.size()[2] - 1];
    let mean = |x: &Tensor| x.mean(None).double_value(&[]);
    [
        mean(&x),
        x.std(false).double_value(&[]),
        mean(&x.select(2, 0).select(1, 0)),
        mean(&x.select(2, width).select(1, height)),
        mean(&x.get(7)),
    ]
}

#[test]
fn the_stages_compute_what_torchvision_computes_for_the_same_image() {
    for (kind, expected) in [(Kind::Resnet18, RESNET_18), (Kind::Resnet34, RESNET_34)] {
        for (stage, expected) in stages(kind, None).iter().zip(expected) {
            for (found, expected) in summary(stage).into_iter().zip(expected) {
                assert!((found / expected - 1.0).abs() < 2e-5, "{kind:?}: {found} {expected}");
            }
        }
    }
}

#[test]
fn a_camera_with_depth_begins_with_the_features_of_its_colours() {
    let [plain, deep, other] =
        [None, Some("depth"), Some("other depth")].map(|depth| stages(Kind::Resnet18, depth).remove(3));
    let moved = |x: &Tensor| (x - &deep).abs().max().double_value(&[]);
    assert_eq!(moved(&other), 0.0, "depth has no part in the features");
    // Four channels and three are summed in another order on some processors: 1.1e-6 of the largest feature.
    let largest = plain.abs().max().double_value(&[]);
    assert!(moved(&plain) < 1e-5 * largest, "{} of {largest}", moved(&plain));
}

#[test]
fn a_norm_is_the_same_map_of_one_image_and_of_many() {
    let store = VarStore::new(Device::Cpu);
    let norm = FrozenNorm::new(&store.root(), 2);
    let _ = norm.mean.shallow_clone().fill_(3.0);
    let _ = norm.variance.shallow_clone().fill_(4.0 - EPSILON);
    let images = Tensor::arange(16, (tch::Kind::Float, Device::Cpu)).view([4, 2, 1, 2]).set_requires_grad(true);
    let mapped = norm.forward(&images);
    assert!((&mapped - (&images - 3.0) / 2.0).abs().max().double_value(&[]) < 1e-6);
    // The map halves, so the gradient of the squares' sum is the map's own output.
    mapped.square().sum(tch::Kind::Float).backward();
    assert!((images.grad() - &mapped).abs().max().double_value(&[]) < 1e-5);
    assert!(store.trainable_variables().is_empty() && store.variables().len() == 4);
}

#[test]
fn networks_have_the_sizes_of_torchvision_s() {
    for (blocks, trained) in [([2, 2, 2, 2], 11_176_512 - 9_600), ([3, 4, 6, 3], 21_284_672 - 17_024)] {
        let store = VarStore::new(Device::Cpu);
        let (_, size) = network(&store.root(), blocks, [3, 480, 640]);
        assert_eq!(size, [512, 15, 20]);
        let count: usize = store.trainable_variables().iter().map(Tensor::numel).sum();
        assert_eq!(count, trained);
    }
}
