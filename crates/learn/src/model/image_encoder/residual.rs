//! A residual network over one camera's images: the blocks of ResNet with group norm in place of batch norm, so that an
//! output does not depend on the batch. Must not depend on given weights, which fit `resnet` alone.

use gleaner_core::Preset;
use tch::nn::{self, Module};

use super::blocks::{self, Names, Norm, Style};
use super::{GROUPS, LARGE};

/// A stage halves the images while they have more places than this.
const PLACES: i64 = 64;

/// Channels of the first stage and blocks of each stage; a stage has twice the channels of the one before.
fn layout(preset: Preset) -> (i64, [usize; 4]) {
    match preset {
        Preset::Tiny => (16, [1; 4]),
        Preset::Small => (32, [2; 4]),
        Preset::Base => (64, [2; 4]),
        Preset::Large => (64, [3, 4, 6, 3]),
    }
}

fn group_norm(path: nn::Path<'_>, channels: i64) -> Box<dyn Module> {
    Box::new(nn::group_norm(path, GROUPS, channels, Default::default()))
}

/// The network for images of `channels` and of this height and width; and the channels, height and width of its output.
pub(super) fn network(path: &nn::Path<'_>, preset: Preset, size: [i64; 3]) -> (nn::SequentialT, [i64; 3]) {
    network_of(path, preset, size, &group_norm)
}

fn network_of(path: &nn::Path<'_>, preset: Preset, size: [i64; 3], norm: Norm<'_>) -> (nn::SequentialT, [i64; 3]) {
    let (channels, blocks) = layout(preset);
    let [_, height, width] = size;
    let names = Names {
        stem: ["stem", "stem_norm"],
        block: |path, stage, block| path / "stage" / stage / block,
        convolutions: ["conv_0", "conv_1"],
        norms: ["norm_0", "norm_1"],
        shortcut: |path| [path / "shortcut", path / "shortcut_norm"],
    };
    let shrinking_stem = height.max(width) > i64::from(LARGE);
    let style = Style { channels, blocks, norm, shrinking_stem, halves: |places| places > PLACES, names };
    blocks::network(path, &style, size)
}

#[cfg(test)]
mod tests {
    use gleaner_core::Words as _;
    use tch::nn::{ModuleT as _, VarStore};
    use tch::{Device, Kind, Tensor};

    use super::*;

    /// Groups divide every number of channels.
    #[test]
    fn channels_are_multiples_of_the_groups() {
        for preset in Preset::ALL.iter().map(|word| word.value) {
            assert_eq!(layout(preset).0 % GROUPS, 0);
        }
    }

    #[test]
    fn presets_have_the_documented_numbers_of_parameters() {
        for (preset, millions) in
            [(Preset::Tiny, 0.3), (Preset::Small, 2.8), (Preset::Base, 11.2), (Preset::Large, 21.3)]
        {
            let store = VarStore::new(Device::Cpu);
            let _ = network(&store.root(), preset, [3, 128, 128]);
            let count: usize = store.trainable_variables().iter().map(Tensor::numel).sum();
            let found = f64::from(u32::try_from(count).unwrap()) / 1e6;
            assert!((found / millions - 1.0).abs() < 0.05, "{preset:?}: {found}");
        }
    }

    #[test]
    fn sizes_are_those_of_the_output() {
        for (height, width) in [(8, 8), (32, 32), (16, 17), (128, 128), (270, 480)] {
            let store = VarStore::new(Device::Cpu);
            let (stages, size) = network(&store.root(), Preset::Tiny, [4, height, width]);
            let seen = stages.forward_t(&Tensor::zeros([1, 4, height, width], (Kind::Float, Device::Cpu)), false);
            assert_eq!(seen.size()[1..], size);
            assert!(size[1] * size[2] <= PLACES.max(256), "{size:?}");
        }
    }

    /// A norm depends on the whole picture, so the test has none.
    #[test]
    fn an_output_without_norms_depends_on_every_corner_of_a_picture_of_128_pixels() {
        let none = |_: nn::Path<'_>, _: i64| -> Box<dyn Module> { Box::new(nn::func(Tensor::shallow_clone)) };
        let corners = |preset| {
            let store = VarStore::new(Device::Cpu);
            let (stages, [_, height, width]) = network_of(&store.root(), preset, [3, 128, 128], &none);
            crate::model::weights::draw(&crate::model::weights::sorted(&store), 1.0, 1);
            let image = Tensor::ones([1, 3, 128, 128], (Kind::Float, Device::Cpu)).set_requires_grad(true);
            let seen = stages.forward_t(&image, false).select(2, height / 2).select(2, width / 2);
            seen.sum(Kind::Float).backward();
            let reach = image.grad().abs().sum_dim_intlist([0i64, 1].as_slice(), false, Kind::Float);
            [(0, 0), (0, 127), (127, 0), (127, 127)].map(|(row, column)| reach.double_value(&[row, column]))
        };
        for preset in [Preset::Tiny, Preset::Small] {
            assert!(corners(preset).iter().all(|gradient| *gradient > 0.0), "{preset:?}");
        }
    }
}
