//! The images of the newest step as a policy reads them: one embedding of them all, or a token of each place.
//! Independent of what a policy predicts from them.

use gleaner_core::{ModelSpec, Words as _};
use tch::Tensor;
use tch::nn;

use crate::model::{IMAGES, ImageEncoder, ImageStages, Size, TokenGrid};
use crate::shape::TaskShape;

gleaner_core::words! {
    /// The form in which a policy reads images.
    pub(in crate::policy) enum ImageTokens {
        /// One embedding of the images of all cameras, made of keypoints: fast, and learnt from few demonstrations.
        Embedding = "embedding",
        /// Up to 8×8 tokens of each camera, with their places, and a transformer encoder that reads them, as in the
        /// paper of ACT. Shows more than a few positions, but needs more steps and demonstrations to learn them, and is
        /// several times slower. Without a history; `keypoint_gain` has no effect.
        Grid = "grid",
    }
}

gleaner_core::settings! {
    /// The images of a policy that can read either form.
    #[derive(Copy)]
    pub(in crate::policy) struct ImagesSpec {
        /// Form in which the decoder reads images.
        pub(in crate::policy) image_tokens: ImageTokens = ImageTokens::Embedding, ImageTokens::shape();
    }
}

/// The network that reads the images of one step.
pub(super) enum Images {
    /// One embedding.
    Embedding(ImageEncoder),
    /// A token of each place of the encoder's last stage.
    Grid(ImageStages, TokenGrid),
}

impl Images {
    /// The encoder is the part `image` of `path`, as it is of a pretrained one; the tokens of a grid are a part of
    /// their own.
    pub(super) fn new(path: &nn::Path<'_>, shape: &TaskShape, model: &ModelSpec, tokens: ImageTokens) -> Self {
        let images = path / IMAGES;
        match tokens {
            ImageTokens::Embedding => Self::Embedding(ImageEncoder::new(&images, shape, model)),
            ImageTokens::Grid => {
                let stages = ImageStages::new(&images, shape, model);
                let grid = TokenGrid::new(&(path / "grid"), stages.sizes(), Size::of(model.preset).width);
                Self::Grid(stages, grid)
            }
        }
    }

    /// Tokens of a step, T.
    pub(super) fn tokens(&self) -> i64 {
        match self {
            Self::Embedding(_) => 1,
            Self::Grid(_, grid) => grid.tokens(),
        }
    }

    /// Standardised images, per camera `[N, C, H, W]`, to the tokens of each step one after the other, `[N, T d]`.
    pub(super) fn forward(&self, images: &[Tensor]) -> Tensor {
        match self {
            Self::Embedding(encoder) => encoder.forward(images),
            Self::Grid(stages, grid) => grid.forward(&stages.forward(images)).flatten(1, 2),
        }
    }
}
