//! The feature maps of cameras as tokens with their positions, as in DETR and ACT. Independent of the network that made
//! the maps and of what reads the tokens.

use tch::nn::{self, ConvConfigND, Module};
use tch::{Device, Kind, Tensor};

use crate::batch::int;
use crate::model::Waves;

/// Most rows and columns of a camera's tokens. A map with more places is read in patches, one token each, which bounds
/// the tokens of a camera to 64.
const SIDE: i64 = 8;
/// The shortest and the longest wave of a position, in sides of an image. The shortest spans two of eight places, the
/// longest rises over the whole side: places are further from each other the further apart they are.
const PERIODS: [f64; 2] = [0.25, 4.0];

/// The tokens of the maps of all cameras.
pub(crate) struct TokenGrid {
    cameras: Vec<CameraTokens>,
    /// `[cameras, d]`.
    camera: Tensor,
}

/// The tokens of one camera's map.
struct CameraTokens {
    /// A token of each patch.
    project: nn::Conv2D,
    /// Columns and rows of zeros that complete the last patches.
    missing: [i64; 2],
    /// `[places, d]`: the waves of each token's row, then of its column.
    position: Tensor,
}

impl TokenGrid {
    /// For maps with these channels, heights and widths.
    pub(crate) fn new(path: &nn::Path<'_>, maps: impl Iterator<Item = [i64; 3]>, width: i64) -> Self {
        let cameras: Vec<_> =
            maps.enumerate().map(|(i, map)| CameraTokens::new(&(path / "camera" / i), map, width)).collect();
        let camera = path.zeros("camera_embedding", &[int(cameras.len()), width]);
        Self { cameras, camera }
    }

    /// Tokens of a step, T.
    pub(crate) fn tokens(&self) -> i64 {
        self.cameras.iter().map(|camera| camera.position.size()[0]).sum()
    }

    /// Maps, per camera `[N, C, H, W]`, to tokens `[N, T, d]`: camera by camera, row by row.
    pub(crate) fn forward(&self, maps: &[Tensor]) -> Tensor {
        let cameras = self.cameras.iter().zip(maps).zip(self.camera.split(1, 0));
        let tokens: Vec<Tensor> = cameras.map(|((camera, map), embedding)| camera.forward(map) + embedding).collect();
        Tensor::cat(&tokens, 1)
    }
}

impl CameraTokens {
    fn new(path: &nn::Path<'_>, [channels, height, width]: [i64; 3], out: i64) -> Self {
        let patch = [height, width].map(|side| (side + SIDE - 1) / SIDE);
        let [rows, columns] = [(height, patch[0]), (width, patch[1])].map(|(side, patch)| (side + patch - 1) / patch);
        let config = ConvConfigND::<[i64; 2]> { stride: patch, ..Default::default() };
        Self {
            project: nn::conv(path / "patch", channels, out, patch, config),
            missing: [columns * patch[1] - width, rows * patch[0] - height],
            position: positions([rows, columns], out, path.device()),
        }
    }

    /// A map `[N, C, H, W]` to tokens `[N, places, d]`.
    fn forward(&self, map: &Tensor) -> Tensor {
        let [columns, rows] = self.missing;
        let whole =
            if self.missing == [0, 0] { map.shallow_clone() } else { map.constant_pad_nd([0, columns, 0, rows]) };
        self.project.forward(&whole).flatten(2, -1).transpose(1, 2) + &self.position
    }
}

/// The embedding of each place of a grid, `[rows · columns, width]`. A token's row and column are in 0 … 1, so that the
/// same place of an image has the same position at every size.
fn positions([rows, columns]: [i64; 2], width: i64, device: Device) -> Tensor {
    let waves = Waves::new(PERIODS, width / 2, device);
    let line = |count: i64| {
        let places = Tensor::arange(count, (Kind::Float, device)) + 0.5;
        waves.of(&(places / count).unsqueeze(-1))
    };
    let row = line(rows).unsqueeze(1).expand([rows, columns, -1], false);
    let column = line(columns).unsqueeze(0).expand([rows, columns, -1], false);
    Tensor::cat(&[row, column], -1).flatten(0, 1)
}

#[cfg(test)]
mod tests {
    use gleaner_core::{ImageEncoder, ModelSpec, Words as _};
    use tch::nn::VarStore;

    use super::super::ImageStages;
    use super::*;
    use crate::model::weights;
    use crate::shape::{CameraShape, TaskShape};

    const FLOAT: (Kind, Device) = (Kind::Float, Device::Cpu);

    fn grid(maps: &[[i64; 3]], width: i64) -> TokenGrid {
        let store = VarStore::new(Device::Cpu);
        let grid = TokenGrid::new(&store.root(), maps.iter().copied(), width);
        weights::draw(&weights::sorted(&store), 1.0, 1);
        grid
    }

    #[test]
    fn cameras_of_any_size_have_at_most_64_tokens_each() {
        let sizes = [(8, 8, false), (16, 17, true), (128, 128, true), (270, 480, false), (4, 3000, false)];
        let cameras =
            sizes.map(|(height, width, depth)| CameraShape { name: "c".into(), height, width, depth, recorded: None });
        let shape = TaskShape { cameras: cameras.to_vec(), ..crate::toy::shape() };
        for image_encoder in ImageEncoder::ALL.iter().map(|word| word.value) {
            let store = VarStore::new(Device::Cpu);
            let spec = ModelSpec { image_encoder, ..ModelSpec::default() };
            let stages = ImageStages::new(&store.root(), &shape, &spec);
            let grid = TokenGrid::new(&(store.root() / "grid"), stages.sizes(), 64);
            let image = |camera: &CameraShape| {
                let sides = [camera.height, camera.width].map(i64::from);
                Tensor::zeros([2, int(camera.channels()), sides[0], sides[1]], FLOAT)
            };
            let tokens = grid.forward(&stages.forward(&shape.cameras.iter().map(image).collect::<Vec<_>>()));
            assert_eq!(tokens.size(), [2, grid.tokens(), 64]);
            let counts: Vec<i64> = grid.cameras.iter().map(|camera| camera.position.size()[0]).collect();
            assert!(counts.iter().all(|count| (1..=64).contains(count)), "{image_encoder:?}: {counts:?}");
            // The maps of a ResNet have a 32nd of each side.
            let of_ends = if stages.sizes().next() == Some([512, 1, 1]) { [1, 16] } else { [64, 64] };
            assert_eq!([counts[0], counts[2]], of_ends, "{image_encoder:?}: {counts:?}");
        }
    }

    #[test]
    fn every_place_of_a_map_is_in_one_token_of_its_camera() {
        // 9 × 15 places in patches of 2 × 2, the last ones incomplete, and a camera of 3 × 3.
        let grid = grid(&[[4, 9, 15], [2, 3, 3]], 16);
        assert_eq!(grid.tokens(), 5 * 8 + 9);
        let maps = [Tensor::zeros([1, 4, 9, 15], FLOAT), Tensor::zeros([1, 2, 3, 3], FLOAT)];
        let plain = grid.forward(&maps);
        for (camera, [row, column], token) in
            [(0, [0, 0], 0), (0, [1, 1], 0), (0, [1, 2], 1), (0, [8, 14], 39), (1, [0, 0], 40), (1, [2, 1], 47)]
        {
            let changed: Vec<Tensor> = maps.iter().map(Tensor::copy).collect();
            let _ = changed[camera].narrow(2, row, 1).narrow(3, column, 1).fill_(1.0);
            let moved = (grid.forward(&changed) - &plain).abs().amax([0i64, 2].as_slice(), false).gt(1e-4);
            let moved = crate::batch::values(&moved.to_kind(Kind::Float));
            let found: Vec<usize> = (0..moved.len()).filter(|at| moved[*at] > 0.0).collect();
            assert_eq!(found, [token], "camera {camera}, row {row}, column {column}");
        }
    }

    #[test]
    fn places_have_positions_of_their_own_further_from_those_far_away() {
        for width in [64, 128, 256, 384] {
            let positions = positions([8, 8], width, Device::Cpu);
            let apart =
                |a: i64, b: i64| (positions.get(a) - positions.get(b)).square().mean(Kind::Float).double_value(&[]);
            for (place, row, column) in (0i64..64).map(|place| (place, place / 8, place % 8)) {
                for other in (0..64).filter(|other| *other != place) {
                    let steps = (row - other / 8).abs().max((column - other % 8).abs());
                    let neighbour = if column < 7 { place + 1 } else { place - 1 };
                    let further = apart(place, other) / apart(place, neighbour);
                    assert!(
                        if steps > 1 { further > 1.1 } else { further > 0.99 },
                        "{width}: {place} {other} {further}"
                    );
                }
            }
        }
    }

    #[test]
    fn equal_images_of_two_cameras_have_different_tokens() {
        let grid = grid(&[[4, 8, 8], [4, 8, 8]], 16);
        let map = Tensor::zeros([1, 4, 8, 8], FLOAT);
        let halves = grid.forward(&[map.shallow_clone(), map]).chunk(2, 1);
        assert!((&halves[0] - &halves[1]).abs().min().double_value(&[]) > 1e-6);
    }
}
