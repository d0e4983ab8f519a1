//! Frames' bytes straight to standardised images: bit for bit what [`images`](crate::batch::images) and
//! [`Statistics::images`] give, but in one pass over the bytes. For few frames with low latency.

use std::sync::OnceLock;

use tch::{Device, Tensor};

use super::{Standard, Statistics};
use crate::batch::{int, squash, values};
use crate::shape::{CameraShape, TaskShape};

/// The value of each byte, for each colour.
type Colours = [[f32; 256]; 3];

/// One camera's statistics as plain numbers.
#[derive(Default)]
pub(crate) struct Lookup(OnceLock<Box<Numbers>>);

struct Numbers {
    colours: Colours,
    /// Mean and deviation of squashed depth.
    depth: Option<(f32, f32)>,
}

impl Lookup {
    fn numbers(&self, standard: &Standard) -> &Numbers {
        self.0.get_or_init(|| Box::new(Numbers::of(standard)))
    }
}

impl Numbers {
    fn of(standard: &Standard) -> Self {
        let (mean, deviation) = (values(&standard.mean), values(&standard.deviation));
        let mut colours = [[0.0; 256]; 3];
        for ((table, mean), deviation) in colours.iter_mut().zip(&mean).zip(&deviation) {
            for (byte, value) in (0u8..=u8::MAX).zip(table) {
                *value = (f32::from(byte) / 255.0 - mean) / deviation;
            }
        }
        Self { colours, depth: mean.get(3).copied().zip(deviation.get(3).copied()) }
    }

    /// Writes one image's planes in sequence.
    fn standardise(&self, image: &[u8], pixels: usize, planes: &mut [f32]) {
        let (colour, depth) = image.split_at(pixels * 3);
        let (reds, rest) = planes.split_at_mut(pixels);
        let (greens, rest) = rest.split_at_mut(pixels);
        let (blues, depths) = rest.split_at_mut(pixels);
        let [red, green, blue] = &self.colours;
        for (((rgb, r), g), b) in colour.as_chunks::<3>().0.iter().zip(reds).zip(greens).zip(blues) {
            *r = red[usize::from(rgb[0])];
            *g = green[usize::from(rgb[1])];
            *b = blue[usize::from(rgb[2])];
        }
        if let Some((mean, deviation)) = self.depth {
            for (bytes, value) in depth.as_chunks::<2>().0.iter().zip(depths) {
                *value = (squash(u16::from_le_bytes(*bytes)) - mean) / deviation;
            }
        }
    }
}

impl Statistics {
    /// Standardised images, per camera `[N, C, H, W]`, of the N `frames`, each `shape.frame_bytes()` long.
    pub(crate) fn frames(&self, shape: &TaskShape, frames: &[&[u8]], device: Device) -> Vec<Tensor> {
        let mut offset = 0;
        let mut all = Vec::with_capacity(shape.cameras.len());
        for (camera, standard) in shape.cameras.iter().zip(&self.cameras) {
            let images = frames.iter().map(|frame| &frame[offset..offset + camera.bytes()]);
            all.push(camera_frames(camera, standard.lookup.numbers(&standard.input), images).to_device(device));
            offset += camera.bytes();
        }
        all
    }
}

fn camera_frames<'a>(
    camera: &CameraShape,
    numbers: &Numbers,
    images: impl ExactSizeIterator<Item = &'a [u8]>,
) -> Tensor {
    let (count, pixels, channels) = (images.len(), camera.pixels(), camera.channels());
    let mut planes = vec![0f32; count * channels * pixels];
    for (image, planes) in images.zip(planes.chunks_mut((channels * pixels).max(1))) {
        numbers.standardise(image, pixels, planes);
    }
    let size = [int(count), int(channels), i64::from(camera.height), i64::from(camera.width)];
    Tensor::from_slice(&planes).view(size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::images;
    use crate::normalize::Sample;
    use crate::trajectory::Trajectory;

    #[test]
    fn every_bit_is_as_in_the_long_way() {
        let camera =
            |name: &str, height, width, depth| CameraShape { name: name.into(), height, width, depth, recorded: None };
        let shape = TaskShape {
            cameras: vec![camera("a", 16, 48, true), camera("b", 8, 32, false)],
            proprioception: 1,
            action: 1,
            ranges: gleaner_core::action::ActionRanges::default(),
        };
        let steps = 3;
        let mut state = 1u32;
        let mut byte = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state.to_be_bytes()[0]
        };
        let bytes: Vec<u8> = (0..steps * shape.frame_bytes()).map(|_| byte()).collect();
        let data = Trajectory::new(&shape, "e", bytes.clone(), vec![0.0; steps], vec![0.0; steps]).unwrap();
        let statistics = Statistics::measure(&shape, &Sample::every(&[&data]), 8, Device::Cpu).unwrap();
        let frames: Vec<&[u8]> = bytes.chunks(shape.frame_bytes()).collect();
        for frames in [&frames[..1], &frames] {
            let long = statistics.images(&images(&shape, frames, Device::Cpu));
            let short = statistics.frames(&shape, frames, Device::Cpu);
            for (long, short) in long.iter().zip(&short) {
                assert_eq!(long.size(), short.size());
                let bits = |tensor: &Tensor| values(tensor).iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                assert_eq!(bits(long), bits(short));
            }
        }
    }
}
