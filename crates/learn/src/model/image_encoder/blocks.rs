//! Residual networks of basic blocks (He et al. 2016): a stem and four stages. Must not depend on what differs between
//! them, which is a [`Style`].

use tch::Tensor;
use tch::nn::{self, Module};

use crate::model::layers::Convolution;

/// Stages of a network; each has twice the channels of the one before.
const STAGES: usize = 4;

/// Makes the norm of a number of channels.
pub(super) type Norm<'a> = &'a dyn Fn(nn::Path<'_>, i64) -> Box<dyn Module>;

/// The differences between the networks.
pub(super) struct Style<'a> {
    /// Channels of the first stage.
    pub(super) channels: i64,
    /// Blocks of each stage.
    pub(super) blocks: [usize; STAGES],
    pub(super) norm: Norm<'a>,
    /// Whether the stem shrinks images by 4.
    pub(super) shrinking_stem: bool,
    /// Whether a stage after the first halves images with this number of places.
    pub(super) halves: fn(i64) -> bool,
    pub(super) names: Names,
}

/// The names of layers: below the path of the network, and below the path of a block.
pub(super) struct Names {
    pub(super) stem: [&'static str; 2],
    /// The path of a block, by its stage and its place in it.
    pub(super) block: for<'a> fn(&nn::Path<'a>, usize, usize) -> nn::Path<'a>,
    pub(super) convolutions: [&'static str; 2],
    pub(super) norms: [&'static str; 2],
    /// The convolution and the norm of a shortcut.
    pub(super) shortcut: for<'a> fn(&nn::Path<'a>) -> [nn::Path<'a>; 2],
}

/// Two convolutions beside a shortcut.
#[derive(Debug)]
struct Block {
    convolutions: [Convolution; 2],
    norms: [Box<dyn Module>; 2],
    /// Where the size changes.
    shortcut: Option<(Convolution, Box<dyn Module>)>,
}

impl Block {
    fn new(path: &nn::Path<'_>, [inputs, outputs, stride]: [i64; 3], style: &Style<'_>) -> Self {
        let Style { names, norm, .. } = style;
        let shortcut = (stride != 1 || inputs != outputs).then(|| {
            let [of_convolution, of_norm] = (names.shortcut)(path);
            (Convolution::new(of_convolution, [inputs, outputs, 1, stride]), norm(of_norm, outputs))
        });
        let [first, second] = names.convolutions;
        Self {
            convolutions: [
                Convolution::new(path / first, [inputs, outputs, 3, stride]),
                Convolution::new(path / second, [outputs, outputs, 3, 1]),
            ],
            norms: names.norms.map(|name| norm(path / name, outputs)),
            shortcut,
        }
    }
}

impl Module for Block {
    fn forward(&self, x: &Tensor) -> Tensor {
        let inner = self.norms[0].forward(&self.convolutions[0].forward(x)).relu();
        let inner = self.norms[1].forward(&self.convolutions[1].forward(&inner));
        match &self.shortcut {
            None => (inner + x).relu(),
            Some((convolution, norm)) => (inner + norm.forward(&convolution.forward(x))).relu(),
        }
    }
}

/// The network for images of `channels` and of this height and width; and the channels, height and width of its output.
pub(super) fn network(
    path: &nn::Path<'_>,
    style: &Style<'_>,
    [channels, mut height, mut width]: [i64; 3],
) -> (nn::SequentialT, [i64; 3]) {
    let mut inputs = style.channels;
    let halved = |side: i64| (side + 1) / 2;
    let stem = if style.shrinking_stem { [channels, inputs, 7, 2] } else { [channels, inputs, 3, 1] };
    let [of_convolution, of_norm] = style.names.stem;
    let norm = (style.norm)(path / of_norm, inputs);
    let mut stages = nn::seq_t().add(Convolution::new(path / of_convolution, stem));
    stages = stages.add_fn(move |x| norm.forward(x).relu());
    if style.shrinking_stem {
        (height, width) = (halved(halved(height)), halved(halved(width)));
        stages = stages.add_fn(|x| x.max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false));
    }
    for (stage, blocks) in style.blocks.into_iter().enumerate() {
        let outputs = if stage == 0 { inputs } else { 2 * inputs };
        let mut stride = 1;
        if stage > 0 && (style.halves)(height * width) {
            stride = 2;
            (height, width) = (halved(height), halved(width));
        }
        for block in 0..blocks {
            let (from, stride) = if block == 0 { (inputs, stride) } else { (outputs, 1) };
            stages = stages.add(Block::new(&(style.names.block)(path, stage, block), [from, outputs, stride], style));
        }
        inputs = outputs;
    }
    (stages, [inputs, height, width])
}
