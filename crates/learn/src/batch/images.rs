//! Image bytes to tensors: colour to 0 … 1, depth squashed to 0 … 1.

use tch::{Device, Kind, Tensor};

use super::int;
use crate::device::send;
use crate::shape::{CameraShape, TaskShape};

/// Per camera `[N, C, H, W]` of the N `frames`, each `shape.frame_bytes()` long.
pub(crate) fn images(shape: &TaskShape, frames: &[&[u8]], device: Device) -> Vec<Tensor> {
    let mut offset = 0;
    let mut all = Vec::with_capacity(shape.cameras.len());
    for camera in &shape.cameras {
        let images: Vec<&[u8]> = frames.iter().map(|frame| &frame[offset..offset + camera.bytes()]).collect();
        all.push(camera_images(camera, &images, device));
        offset += camera.bytes();
    }
    all
}

fn camera_images(camera: &CameraShape, images: &[&[u8]], device: Device) -> Tensor {
    let (height, width) = (i64::from(camera.height), i64::from(camera.width));
    let count = int(images.len());
    let split = camera.pixels() * 3;
    let mut colour = Vec::with_capacity(images.len() * split);
    for image in images {
        colour.extend_from_slice(&image[..split]);
    }
    let colour = Tensor::from_data_size(&colour, &[count, height, width, 3], Kind::Uint8);
    let all = Tensor::empty([count, int(camera.channels()), height, width], (Kind::Float, device));
    // Bytes are sent, and turned into numbers on the way to their places: one pass and no second copy in floats, of
    // which a batch of windows has tens of megabytes.
    let mut place = all.narrow(1, 0, 3);
    place.copy_(&send(&colour, device).permute([0, 3, 1, 2]));
    place /= 255.0;
    if camera.depth {
        let mut depth = Vec::with_capacity(images.len() * camera.pixels());
        for image in images {
            let millimetres = image[split..].as_chunks::<2>().0.iter();
            depth.extend(millimetres.map(|bytes| squash(u16::from_le_bytes(*bytes))));
        }
        let depth = Tensor::from_slice(&depth).view([count, 1, height, width]);
        all.narrow(1, 3, 1).copy_(&send(&depth, device));
    }
    all
}

/// Depth z in metres as z / (1 + z): centimetres at the hand keep their weight beside a distant wall, and "no reading"
/// stays 0.
pub(crate) fn squash(millimetres: u16) -> f32 {
    let metres = f32::from(millimetres) / 1000.0;
    metres / (1.0 + metres)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_and_depth_land_in_their_channels() {
        let camera = |depth| CameraShape { name: "c".into(), height: 1, width: 2, depth, recorded: None };
        let shape = TaskShape {
            cameras: vec![camera(false), camera(true)],
            proprioception: 1,
            action: 1,
            ranges: gleaner_core::action::ActionRanges::default(),
        };
        let mut frame = vec![255, 0, 0, 0, 0, 51];
        frame.extend([0, 255, 0, 0, 0, 0]);
        frame.extend(1000u16.to_le_bytes());
        frame.extend(0u16.to_le_bytes());
        let tensors = images(&shape, &[&frame], Device::Cpu);
        assert_eq!(tensors[0].size(), [1, 3, 1, 2]);
        assert_eq!(super::super::values(&tensors[0]), [1.0, 0.0, 0.0, 0.0, 0.0, 0.2]);
        assert_eq!(tensors[1].size(), [1, 4, 1, 2]);
        assert_eq!(super::super::values(&tensors[1])[2..4], [1.0, 0.0]);
        assert_eq!(super::super::values(&tensors[1])[6..], [0.5, 0.0]);
    }

    #[test]
    fn each_byte_is_its_exact_share_in_every_frame() {
        let camera = CameraShape { name: "c".into(), height: 16, width: 16, depth: false, recorded: None };
        let shape = TaskShape {
            cameras: vec![camera],
            proprioception: 1,
            action: 1,
            ranges: gleaner_core::action::ActionRanges::default(),
        };
        let (rising, falling) = (0..=255u8, (0..=255u8).rev());
        let frames =
            [rising.flat_map(|byte| [byte; 3]).collect::<Vec<_>>(), falling.flat_map(|byte| [byte; 3]).collect()];
        let found = super::super::values(&images(&shape, &[&frames[0], &frames[1]], Device::Cpu)[0]);
        let plane = |reverse: bool| (0..=255u8).map(move |at| f32::from(if reverse { 255 - at } else { at }) / 255.0);
        let expected: Vec<f32> = [false, true].into_iter().flat_map(|reverse| [reverse; 3]).flat_map(plane).collect();
        assert_eq!(found, expected);
    }
}
