//! Statistics of the cameras' images: of the input of the image encoder and of the targets of H_o.

use tch::{Device, Kind, Tensor};

use super::frames::Lookup;
use super::{Sample, Standard};
use crate::batch::images;
use crate::error::LearnError;
use crate::shape::{CameraShape, TaskShape};

/// Number of images in the sample of the image statistics; an even sample of the steps when there are more.
const SAMPLED_FRAMES: usize = 2_048;
const CHUNK: usize = 64;

/// Mean and deviation of ImageNet's colours, of values in 0 … 1: networks pretrained on it expect images standardised
/// by these.
const IMAGENET: [[f32; 3]; 2] = [[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]];

/// Statistics of one camera's images.
pub(crate) struct CameraStandard {
    /// Statistics of the image encoder's input: per channel, `[C, 1, 1]`.
    pub(crate) input: Standard,
    /// Statistics of H_o's target: the down-sampled image minus its mean image `[C, h, w]`, in units of the channel's
    /// remaining deviation `[C, 1, 1]`. So the static background costs nothing, and a pixel that hardly ever changes is
    /// not amplified.
    pub(crate) target: Standard,
    /// `input` for bytes.
    pub(super) lookup: Lookup,
}

impl CameraStandard {
    /// The same, with ImageNet's colours for the input; its depth keeps its own statistics.
    pub(super) fn of_imagenet(self) -> Self {
        let Standard { mean, deviation } = &self.input;
        let [mean, deviation] = [(mean, IMAGENET[0]), (deviation, IMAGENET[1])].map(|(measured, colours)| {
            let replaced = measured.copy();
            let colours = Tensor::from_slice(&colours).view([3, 1, 1]);
            replaced.narrow(0, 0, 3).copy_(&colours);
            replaced
        });
        Self { input: Standard { mean, deviation }, lookup: Lookup::default(), ..self }
    }

    /// The targets of H_o, `[N, C, h, w]`, for images `[N, C, H, W]`.
    pub(crate) fn small(&self, images: &Tensor) -> Tensor {
        let size = self.target.mean.size();
        self.target.apply(&images.adaptive_avg_pool2d(&size[1..]))
    }
}

/// Height and width of the image that H_o predicts.
pub(crate) fn target_size(camera: &CameraShape, target: u32) -> [i64; 2] {
    [camera.height, camera.width].map(|side| i64::from(side.min(target)))
}

/// Sums over the sampled images of one camera.
struct Sums {
    channel: Tensor,
    channel_square: Tensor,
    target: Tensor,
    target_square: Tensor,
}

/// Measures every camera over an even part of the sample.
///
/// # Errors
/// [`LearnError::Steps`].
pub(super) fn measure(
    shape: &TaskShape,
    sample: &Sample<'_>,
    target: u32,
    device: Device,
) -> Result<Vec<CameraStandard>, LearnError> {
    let steps = sample.some_steps(SAMPLED_FRAMES);
    let mut sums: Vec<Option<Sums>> = shape.cameras.iter().map(|_| None).collect();
    let mut frames = vec![0; CHUNK.min(steps.len()) * shape.frame_bytes()];
    for chunk in steps.chunks(CHUNK) {
        for ((episode, step), frame) in chunk.iter().zip(frames.chunks_exact_mut(shape.frame_bytes())) {
            episode.read_frames(*step..step + 1, frame)?;
        }
        let frames: Vec<&[u8]> = frames.chunks_exact(shape.frame_bytes()).take(chunk.len()).collect();
        for (i, image) in images(shape, &frames, device).iter().enumerate() {
            let size = target_size(&shape.cameras[i], target);
            let part = Sums::of(image, size);
            sums[i] = Some(match sums[i].take() {
                Some(sum) => sum.plus(&part),
                None => part,
            });
        }
    }
    let count = f64::from(u32::try_from(steps.len()).unwrap_or(u32::MAX));
    let finish = |sums: Sums| sums.standard(count, device);
    Ok(sums.into_iter().flatten().map(finish).collect())
}

impl Sums {
    /// The sums of `[N, C, H, W]`; pixels are averaged, images are summed.
    fn of(images: &Tensor, size: [i64; 2]) -> Self {
        let places = [2i64, 3];
        let mean = |x: &Tensor| x.mean_dim(places.as_slice(), true, Kind::Double);
        let sum = |x: &Tensor| x.sum_dim_intlist([0i64].as_slice(), false, Kind::Double);
        let small = images.adaptive_avg_pool2d(size).to_kind(Kind::Double);
        let channel = mean(images);
        // Not the mean of squares in single precision, whose rounding would be the deviation of a channel of one colour.
        let spread = images.var_dim(places.as_slice(), false, true).to_kind(Kind::Double);
        Self {
            channel_square: sum(&(spread + channel.square())),
            channel: sum(&channel),
            target: sum(&small),
            target_square: sum(&mean(&small.square())),
        }
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            channel: &self.channel + &other.channel,
            channel_square: &self.channel_square + &other.channel_square,
            target: &self.target + &other.target,
            target_square: &self.target_square + &other.target_square,
        }
    }

    fn standard(&self, count: f64, device: Device) -> CameraStandard {
        let deviation = |square: Tensor| square.clamp_min(0.0).sqrt();
        let channel = &self.channel / count;
        let spread = deviation(&self.channel_square / count - channel.square());
        let target = &self.target / count;
        let still = target.square().mean_dim([1i64, 2].as_slice(), true, Kind::Double);
        let moving = deviation(&self.target_square / count - still);
        let size = spread.zeros_like();
        CameraStandard {
            input: Standard::new(&channel, &spread, &size, device),
            target: Standard::new(&target, &moving, &size, device),
            lookup: Lookup::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::values;

    #[test]
    fn a_channel_of_one_colour_is_constant_whatever_the_colour() {
        for byte in 0..=u8::MAX {
            let image = Tensor::full([3, 1, 8, 9], f64::from(byte), (Kind::Float, Device::Cpu)) / 255.0;
            let standard = Sums::of(&image, [8, 8]).standard(3.0, Device::Cpu);
            assert_eq!(values(&standard.input.deviation), [1.0], "{byte}");
        }
        // Of two grey levels, the deviation is half their distance.
        let image = Tensor::from_slice(&[0.25f32, 0.5]).view([1, 1, 1, 2]);
        let standard = Sums::of(&image, [1, 2]).standard(1.0, Device::Cpu);
        assert_eq!(values(&standard.input.deviation), [0.125]);
    }

    #[test]
    fn a_still_image_is_the_mean_image_and_movement_has_unit_deviation() {
        let still = Tensor::from_slice(&[0.2f32, 0.8, 0.2, 0.8]).view([2, 1, 1, 2]);
        let sums = Sums::of(&still, [1, 2]);
        let standard = sums.standard(2.0, Device::Cpu);
        assert_eq!(values(&standard.target.apply(&still)), [0.0; 4]);
        let moving = Tensor::from_slice(&[0.0f32, 1.0, 1.0, 0.0]).view([2, 1, 1, 2]);
        let standard = Sums::of(&moving, [1, 2]).standard(2.0, Device::Cpu);
        assert_eq!(values(&standard.target.apply(&moving)), [-1.0, 1.0, 1.0, -1.0]);
    }
}
