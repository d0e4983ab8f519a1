//! Standardisation: mean and deviation of everything the model reads or predicts, measured once over D_u, or over the
//! steps that a policy learns from, and kept in every checkpoint. Independent of the model.

mod cameras;
mod features;
mod frames;
mod moments;
mod range;
mod sample;
mod standard;

pub(crate) use cameras::target_size;
pub(crate) use features::FeatureScale;
pub(crate) use range::Ranges;
pub(crate) use sample::Sample;
pub(crate) use standard::Standard;

use std::collections::BTreeMap;

use gleaner_core::ImageEncoder;
use tch::{Device, Tensor};

use crate::batch::int;
use crate::error::LearnError;
use crate::shape::{CameraShape, TaskShape};
use cameras::CameraStandard;
use frames::Lookup;
use moments::Moments;

/// A deviation below this part of the values' magnitude is rounding noise: the dimension is constant.
const CONSTANT: f64 = 1e-6;

/// The name of the held actions in a checkpoint.
const HELD: &str = "statistics.action.held";

/// All statistics of a data set.
pub(crate) struct Statistics {
    /// Per dimension of m, `[M]`.
    pub(crate) proprioception: Standard,
    /// Per dimension of a, `[A]`.
    pub(crate) action: Standard,
    /// Per dimension of a, `[2, A]`: 1 where it changed and 0 elsewhere; its value where it never changed.
    held: Tensor,
    /// Per camera.
    pub(crate) cameras: Vec<CameraStandard>,
}

/// Per dimension whether its values differ (1 or 0), and their value where they do not, `[2, A]`.
fn held_actions(ranges: &Ranges, device: Device) -> Tensor {
    let each = ranges.middles().map(|(middle, half)| if half.is_some() { (1f32, 0.0) } else { (0.0, middle) });
    let (moves, value): (Vec<f32>, Vec<f32>) = each.unzip();
    Tensor::from_slice2(&[moves, value]).to_device(device)
}

impl Statistics {
    /// Measures a sample, whose numbers are read once. Images are down-sampled to at most `target` a side for H_o.
    ///
    /// # Errors
    /// [`LearnError::Steps`].
    pub(crate) fn measure(
        shape: &TaskShape,
        sample: &Sample<'_>,
        target: u32,
        device: Device,
    ) -> Result<Self, LearnError> {
        let (mut m, mut a, mut held) =
            (Moments::new(shape.proprioception), Moments::new(shape.action), Ranges::new(shape.action));
        sample.each(shape, &mut |proprioception, action| {
            m.add(proprioception);
            a.add(action);
            held.add(action);
        })?;
        Ok(Self {
            held: held_actions(&held, device),
            proprioception: m.standard(device),
            action: a.standard(device),
            cameras: cameras::measure(shape, sample, target, device)?,
        })
    }

    /// The statistics for a model with this image encoder: a ResNet with given weights sees colours as it was trained
    /// to.
    pub(crate) fn for_image_encoder(mut self, image_encoder: ImageEncoder) -> Self {
        if image_encoder.is_resnet() {
            self.cameras = self.cameras.into_iter().map(CameraStandard::of_imagenet).collect();
        }
        self
    }

    /// These statistics, holding the actions that never change in another sample.
    ///
    /// # Errors
    /// [`LearnError::Steps`].
    pub(crate) fn holding(self, shape: &TaskShape, sample: &Sample<'_>) -> Result<Self, LearnError> {
        let held = held_actions(&Ranges::of_actions(shape, sample)?, self.held.device());
        Ok(Self { held, ..self })
    }

    /// Per dimension of a, `[A]`: 1 where it changed, and 0 where [`Statistics::actions`] keeps its value.
    pub(crate) fn moves(&self) -> Tensor {
        self.held.get(0)
    }

    /// Predicted actions `[…, A]` in physical units. A dimension that never changed keeps its value.
    pub(crate) fn actions(&self, standardised: &Tensor) -> Tensor {
        self.action.invert(standardised) * self.moves() + self.held.get(1)
    }

    /// Standardises images, per camera `[N, C, H, W]`, for the image encoder.
    pub(crate) fn images(&self, images: &[Tensor]) -> Vec<Tensor> {
        images.iter().zip(&self.cameras).map(|(image, camera)| camera.input.apply(image)).collect()
    }

    /// Every tensor with its name in a checkpoint.
    pub(crate) fn named(&self) -> Vec<(String, Tensor)> {
        let mut named = Vec::new();
        self.proprioception.name_into("statistics.proprioception", &mut named);
        self.action.name_into("statistics.action", &mut named);
        named.push((HELD.to_owned(), self.held.shallow_clone()));
        for (i, camera) in self.cameras.iter().enumerate() {
            camera.input.name_into(&format!("statistics.camera.{i}.input"), &mut named);
            camera.target.name_into(&format!("statistics.camera.{i}.target"), &mut named);
        }
        named
    }

    /// The inverse of [`Statistics::named`].
    pub(crate) fn from_named(
        shape: &TaskShape,
        target: u32,
        named: &BTreeMap<String, Tensor>,
        device: Device,
    ) -> Result<Self, LearnError> {
        let vector = |name: &str, width: usize| {
            let size = [int(width)];
            let prefix = format!("statistics.{name}");
            Standard::from_named(&prefix, [&size, &size], named, device)
        };
        let camera = |(i, camera): (usize, &CameraShape)| {
            let channels = int(camera.channels());
            let each = [channels, 1, 1];
            let [height, width] = target_size(camera, target);
            let prefix = format!("statistics.camera.{i}");
            Ok(CameraStandard {
                input: Standard::from_named(&format!("{prefix}.input"), [&each, &each], named, device)?,
                target: Standard::from_named(
                    &format!("{prefix}.target"),
                    [&[channels, height, width], &each],
                    named,
                    device,
                )?,
                lookup: Lookup::default(),
            })
        };
        Ok(Self {
            proprioception: vector("proprioception", shape.proprioception)?,
            action: vector("action", shape.action)?,
            held: match named.get(HELD) {
                Some(held) if held.size() == [2, int(shape.action)] => held.to_device(device),
                Some(_) => return Err(LearnError::Checkpoint(format!("`{HELD}` does not have two rows of actions"))),
                // Checkpoints of earlier versions hold no action.
                None => Tensor::from_slice2(&[vec![1f32; shape.action], vec![0.0; shape.action]]).to_device(device),
            },
            cameras: shape.cameras.iter().enumerate().map(camera).collect::<Result<_, LearnError>>()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use gleaner_core::action::ActionRange;

    use super::*;
    use crate::batch::{rows, values};
    use crate::error::SourceError;
    use crate::steps::{Numbers, StepSource, StepWidths};
    use crate::trajectory::Trajectory;

    /// Steps that count how many of their numbers are read.
    struct Counted(Arc<dyn StepSource>, AtomicUsize);

    impl StepSource for Counted {
        fn steps(&self) -> usize {
            self.0.steps()
        }

        fn widths(&self) -> StepWidths {
            self.0.widths()
        }

        fn numbers(&self, steps: Range<usize>) -> Result<Numbers, SourceError> {
            self.1.fetch_add(steps.len(), Ordering::Relaxed);
            self.0.numbers(steps)
        }

        fn frames(&self, steps: Range<usize>, frames: &mut [u8]) -> Result<(), SourceError> {
            self.0.frames(steps, frames)
        }
    }

    #[test]
    fn numbers_of_each_step_are_read_once() {
        let episode = crate::toy::episode("e", 1, 6, true);
        let counted = Arc::new(Counted(episode.source, AtomicUsize::new(0)));
        let episode = Trajectory { id: "e".to_owned(), source: Arc::<Counted>::clone(&counted) };
        Statistics::measure(&crate::toy::shape(), &Sample::every(&[&episode]), 8, Device::Cpu).unwrap();
        assert_eq!(counted.1.load(Ordering::Relaxed), 6);
    }

    #[test]
    fn actions_beyond_their_ranges_are_measured_as_a_robot_executes_them() {
        let ranges = [ActionRange::Binary(-1.0, 1.0), ActionRange::Within(-0.01, 0.01)];
        let shape = TaskShape { ranges: ranges.into_iter().collect(), ..crate::toy::shape() };
        let recorded = vec![0.3, 0.005, -0.1, 7.0, 0.2, -90.0, -0.4, 0.0];
        let executed = vec![1.0, 0.005, -1.0, 0.01, 1.0, -0.01, -1.0, 0.0];
        let episode = crate::toy::episode("e", 1, 4, true);
        let found = [recorded, executed].map(|actions| {
            let episode = episode.with_actions(actions);
            let sample = Sample::every(&[&episode]);
            let measured = Statistics::measure(&shape, &sample, 8, Device::Cpu).unwrap();
            let middles: Vec<_> = Ranges::of_actions(&shape, &sample).unwrap().middles().collect();
            let Statistics { action: Standard { mean, deviation }, held, .. } = &measured;
            ([mean, deviation, held].map(values), middles)
        });
        assert_eq!(found[0], found[1]);
        assert_eq!(found[0].0[1][0], 1f32.next_up());
        assert_eq!(found[0].1, [(0.0, Some(1.0)), (0.0, Some(0.01))]);
    }

    #[test]
    fn an_action_that_never_changes_is_returned_exactly() {
        let shape = crate::toy::shape();
        let episode = crate::toy::episode("e", 1, 6, true);
        let episode = episode.changed(|arrays| arrays.action.chunks_mut(2).for_each(|action| action[1] = 0.3));
        let data: [&Trajectory; 1] = [&episode];
        let statistics = Statistics::measure(&shape, &Sample::every(&data), 8, Device::Cpu).unwrap();
        let predicted = rows(&[0.7, -0.4], 2, Device::Cpu);
        let free = values(&statistics.action.invert(&predicted));
        assert_eq!(values(&statistics.actions(&predicted)), [free[0], 0.3]);
        let named = statistics.named().into_iter().collect();
        let back = Statistics::from_named(&shape, 8, &named, Device::Cpu).unwrap();
        assert_eq!(values(&back.actions(&predicted)), [free[0], 0.3]);
        let earlier = named.into_iter().filter(|(name, _)| name != HELD).collect();
        let earlier = Statistics::from_named(&shape, 8, &earlier, Device::Cpu).unwrap();
        assert_eq!(values(&earlier.actions(&predicted)), free);
    }
}
