//! Random changes to a batch's inputs: images are shifted with the edge repeated, and their brightness and contrast
//! changed. Depth is shifted with its colour and otherwise unchanged, because it is a measurement. Proprioception has
//! noise, and is dropped at some steps.

use std::collections::HashMap;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use tch::{Kind, Tensor};

use crate::batch::{Batch, int, rows};
use crate::device::send;
use crate::normalize::Standard;
use crate::random::normal;
use gleaner_core::Augmentation;

const COLOURS: i64 = 3;

/// The change of all images of one episode in one batch.
#[derive(Debug, Clone, Copy)]
struct Change {
    /// Pixels down and right.
    shift: [i64; 2],
    /// Added to colours of 0 … 1.
    brightness: f32,
    /// Factor of a colour's distance from its image's mean.
    contrast: f32,
}

/// Changes the inputs of `batch` according to `augmentation`. The images of an episode have one draw: each frame is
/// stored once for all windows that contain it, and the motion within a window is preserved. Proprioception has a draw
/// for each step. Targets are the changed images, and numbers as they are. `standard` is that of the proprioception.
pub(crate) fn augment(batch: &mut Batch, augmentation: &Augmentation, standard: &Standard, rng: &mut ChaCha8Rng) {
    if *augmentation == Augmentation::default() {
        return;
    }
    let mut drawn = HashMap::new();
    let of_episode = |episode: &usize| *drawn.entry(*episode).or_insert_with(|| Change::draw(augmentation, rng));
    let changes: Vec<Change> = batch.whole.episodes.iter().map(of_episode).collect();
    let changes = batch.whole.values_of_steps(changes);
    for images in &mut batch.images {
        if augmentation.shift_pixels > 0 {
            *images = shift(images, &changes);
        }
        if augmentation.brightness > 0.0 || augmentation.contrast > 0.0 {
            *images = jitter(images, &changes);
        }
    }
    let mut seen = standard.apply(&batch.proprioception);
    if augmentation.proprioception_noise > 0.0 {
        seen += offsets(batch, rng) * augmentation.proprioception_noise * standard.varies();
    }
    if augmentation.proprioception_dropout > 0.0 {
        seen *= kept(batch, augmentation.proprioception_dropout, rng);
    }
    if augmentation.proprioception_noise > 0.0 || augmentation.proprioception_dropout > 0.0 {
        batch.seen_proprioception = standard.invert(&seen);
    }
}

/// 0 for the steps whose proprioception is dropped, otherwise 1, `[N, 1]`.
fn kept(batch: &Batch, dropout: f64, rng: &mut ChaCha8Rng) -> Tensor {
    let kept: Vec<f32> = batch.whole.episodes.iter().map(|_| f32::from(u8::from(!rng.random_bool(dropout)))).collect();
    batch.whole.of_steps(rows(&kept, 1, batch.proprioception.device()))
}

/// A normal number for each value of each step, `[N, M]`.
fn offsets(batch: &Batch, rng: &mut ChaCha8Rng) -> Tensor {
    let width = usize::try_from(batch.proprioception.size()[1]).unwrap_or(0);
    let drawn = normal(rng, batch.whole.episodes.len() * width);
    batch.whole.of_steps(rows(&drawn, width, batch.proprioception.device()))
}

impl Change {
    /// Draws every number for any setting, so that one setting does not change another's draws.
    fn draw(augmentation: &Augmentation, rng: &mut ChaCha8Rng) -> Self {
        let pixels = i64::from(augmentation.shift_pixels);
        let shift = [(); 2].map(|()| rng.random_range(-pixels..=pixels));
        #[expect(clippy::cast_possible_truncation, reason = "settings between 0 and 1")]
        let mut within = |most: f64| (most * rng.random_range(-1.0..=1.0)) as f32;
        Self { shift, brightness: within(augmentation.brightness), contrast: 1.0 + within(augmentation.contrast) }
    }
}

/// `[N, C, H, W]`, each image shifted by its change.
fn shift(images: &Tensor, changes: &[Change]) -> Tensor {
    let size = images.size();
    let mut images = images.shallow_clone();
    for axis in 0..2 {
        let (dimension, side) = (axis + 2, size[axis + 2]);
        let from = changes.iter().flat_map(|change| (0..side).map(|at| (at - change.shift[axis]).clamp(0, side - 1)));
        let mut place = [size[0], 1, 1, 1];
        place[dimension] = side;
        let from = send(&Tensor::from_slice(&from.collect::<Vec<i64>>()).view(place), images.device());
        images = images.gather(int(dimension), &from.expand(size.as_slice(), false), false);
    }
    images
}

/// `[N, C, H, W]`, the colours of each image changed by its change.
fn jitter(images: &Tensor, changes: &[Change]) -> Tensor {
    let each = |value: fn(&Change) -> f32| {
        let values: Vec<f32> = changes.iter().map(value).collect();
        send(&Tensor::from_slice(&values).view([-1, 1, 1, 1]), images.device())
    };
    let colour = images.narrow(1, 0, COLOURS);
    let mean = colour.mean_dim([1i64, 2, 3].as_slice(), true, Kind::Float);
    let stretched = (colour - &mean) * each(|change| change.contrast) + mean + each(|change| change.brightness);
    let others = images.narrow(1, COLOURS, images.size()[1] - COLOURS);
    Tensor::cat(&[stretched.clamp(0.0, 1.0), others], 1)
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::batch::{Segment, values};
    use crate::random::{Purpose, generator};
    use crate::toy;

    /// Two episodes, steps 3 … 6 of each.
    fn batch() -> Batch {
        let data = [toy::episode("a", 1, 8, true), toy::episode("b", 2, 8, true)];
        let end = |trajectory| Segment { trajectory, step: 6, weight: 1.0 };
        Batch::collect(&toy::shape(), &[&data[0], &data[1]], &[end(0), end(1)], 4, Device::Cpu).unwrap()
    }

    fn augmented(augmentation: Augmentation, seed: u64) -> Tensor {
        changed(augmentation, seed).images.remove(0)
    }

    fn changed(augmentation: Augmentation, seed: u64) -> Batch {
        let mut batch = batch();
        let rows = [[0.0f32, 1.0, 5.0], [1.0, 5.0, 5.0]];
        let standard = Standard::of_rows(rows.iter().map(<[f32; 3]>::as_slice), 3, Device::Cpu);
        augment(&mut batch, &augmentation, &standard, &mut generator(seed, Purpose::Augmentation, 0));
        batch
    }

    #[test]
    fn noise_on_proprioception_is_a_draw_for_each_step_and_leaves_targets() {
        let augmentation = Augmentation { proprioception_noise: 0.5, ..Augmentation::default() };
        let mut drawn = Vec::new();
        for seed in 0..200 {
            let batch = changed(augmentation, seed);
            assert_eq!(values(&batch.proprioception), values(&super::tests::batch().proprioception));
            // In deviations, 0.5 and 2 of the first two values; the third never varies.
            let offset = (&batch.seen_proprioception - &batch.proprioception) / Tensor::from_slice(&[0.5f32, 2.0, 1.0]);
            let offset = values(&offset);
            assert!(offset.chunks(3).all(|frame| frame[2] == 0.0));
            let steps: Vec<&[f32]> = offset.chunks(3).collect();
            assert!(steps.len() == 8 && steps.windows(2).all(|pair| (pair[0][0] - pair[1][0]).abs() > 1e-6));
            drawn.extend(steps.iter().flat_map(|step| step[..2].to_vec()));
        }
        let square: f32 = drawn.iter().map(|value| value * value).sum::<f32>() / 3_200.0;
        assert!((0.2..0.3).contains(&square), "{square}, not 0.25");
    }

    #[test]
    fn dropped_proprioception_is_the_mean_at_single_steps() {
        let augmentation = Augmentation { proprioception_dropout: 0.4, ..Augmentation::default() };
        let mut dropped = 0;
        for seed in 0..500 {
            let batch = changed(augmentation, seed);
            let (seen, plain) = (values(&batch.seen_proprioception), values(&batch.proprioception));
            for (seen, plain) in seen.chunks(3).zip(plain.chunks(3)) {
                let mean = seen.iter().zip([0.5, 3.0, 5.0]).all(|(a, b)| (a - b).abs() < 1e-5);
                let same = seen.iter().zip(plain).all(|(a, b)| (a - b).abs() < 1e-5);
                assert!(mean != same, "{seen:?}");
                dropped += u32::from(mean);
            }
        }
        assert!((1_480..1_720).contains(&dropped), "{dropped} of 4000");
    }

    #[test]
    fn nothing_asked_changes_nothing_and_the_same_key_repeats() {
        let plain = values(&batch().images[0]);
        assert_eq!(plain, values(&augmented(Augmentation::default(), 1)));
        let all = Augmentation { shift_pixels: 3, brightness: 0.2, contrast: 0.2, ..Augmentation::default() };
        let first = values(&augmented(all, 1));
        assert_eq!(first, values(&augmented(all, 1)));
        assert_ne!(first, values(&augmented(all, 2)));
        assert_ne!(first, plain);
    }

    #[test]
    fn a_shift_moves_colour_and_depth_alike_and_repeats_the_edge() {
        let image = Tensor::arange(2 * 12, (Kind::Float, Device::Cpu)).view([1, 2, 3, 4]);
        let change = Change { shift: [1, -2], brightness: 0.0, contrast: 1.0 };
        // One row down, two columns left.
        let moved = [[2., 3., 3., 3.], [2., 3., 3., 3.], [6., 7., 7., 7.]].concat();
        let expected: Vec<f32> = moved.iter().copied().chain(moved.iter().map(|value| value + 12.0)).collect();
        assert_eq!(values(&shift(&image, &[change])), expected);
    }

    #[test]
    fn frames_of_an_episode_change_alike_and_stay_within_the_range_asked() {
        let plain = batch().images.remove(0);
        let augmentation = Augmentation { brightness: 0.2, ..Augmentation::default() };
        let mut steps = Vec::new();
        for seed in 0..50 {
            let moved = values(&(augmented(augmentation, seed) - &plain).select(1, 0).amax([1i64, 2], false));
            let episodes: Vec<f32> = moved.chunks(4).map(|frames| frames[0]).collect();
            assert!(moved.chunks(4).all(|frames| frames.iter().all(|step| (step - frames[0]).abs() < 1e-6)));
            assert_ne!(episodes[0], episodes[1]);
            steps.extend(episodes);
        }
        assert!(steps.iter().all(|step| step.abs() <= 0.2 + 1e-6));
        assert!(steps.iter().any(|step| *step > 0.1) && steps.iter().any(|step| *step < -0.1));
    }

    #[test]
    fn colour_jitter_leaves_depth_and_contrast_leaves_the_mean() {
        let plain = batch().images.remove(0);
        let moved = augmented(Augmentation { contrast: 0.4, ..Augmentation::default() }, 4);
        assert_eq!(values(&plain.select(1, 3)), values(&moved.select(1, 3)));
        let mean = |images: &Tensor| values(&images.narrow(1, 0, 3).mean_dim([1i64, 2, 3].as_slice(), false, None));
        let spread = |images: &Tensor| images.narrow(1, 0, 3).std(false).double_value(&[]);
        // Colours far from 0 and 1 are not clamped.
        assert!(mean(&plain).iter().zip(mean(&moved)).all(|(a, b)| (a - b).abs() < 0.02));
        assert!((spread(&plain) - spread(&moved)).abs() > 1e-3);
    }
}
