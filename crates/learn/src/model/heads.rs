//! The decoder heads H_o, H_m and H_a: features to standardised predictions.

use tch::Tensor;
use tch::nn::{self, Module};

use super::{Perceptron, Size};
use crate::batch::int;
use crate::normalize::target_size;
use crate::shape::TaskShape;
use gleaner_core::ActionToken;

/// One hidden layer.
struct Head {
    hidden: nn::Linear,
    out: nn::Linear,
}

impl Head {
    fn new(path: &nn::Path<'_>, width: i64, outputs: i64) -> Self {
        Self {
            hidden: nn::linear(path / "hidden", width, width, Default::default()),
            out: nn::linear(path / "out", width, outputs, Default::default()),
        }
    }

    fn forward(&self, z: &Tensor) -> Tensor {
        self.out.forward(&self.hidden.forward(z).gelu("none"))
    }
}

/// The three heads.
pub(crate) struct Heads {
    image: Head,
    proprioception: Head,
    action: Head,
    /// The head of the action after a history, if that is read from the image token.
    /// It reads the image token, the images' embedding and the proprioception of a step. Proprioception enters as its few
    /// values: as wide as a token, it would outweigh what changes in the images, and the policy would replay a path.
    step: Option<Perceptron>,
}

impl Heads {
    pub(super) fn new(path: &nn::Path<'_>, shape: &TaskShape, size: &Size, token: ActionToken) -> Self {
        let pixels = |camera| target_size(camera, size.target).iter().product::<i64>();
        let image = shape.cameras.iter().map(|camera| int(camera.channels()) * pixels(camera)).sum();
        Self {
            image: Head::new(&(path / "image"), size.width, image),
            proprioception: Head::new(&(path / "proprioception"), size.width, int(shape.proprioception)),
            action: Head::new(&(path / "action"), size.width, int(shape.action)),
            step: (token == ActionToken::Image).then(|| {
                let (inputs, wide) = (2 * size.width + int(shape.proprioception), Perceptron::WIDE * size.width);
                Perceptron::new(&(path / "step"), inputs, wide, int(shape.action))
            }),
        }
    }

    /// The action after a history, `[..., A]`, from the parts of a step: its image token z and its images' embedding
    /// `[..., d]`, and its standardised proprioception `[..., M]`. `None` if it is read from a token alone.
    pub(crate) fn step(&self, parts: impl FnOnce() -> [Tensor; 3]) -> Option<Tensor> {
        self.step.as_ref().map(|head| head.forward(&Tensor::cat(&parts(), -1)))
    }

    /// H_o: `[..., d]` to all cameras' down-sampled images, flattened and concatenated.
    pub(crate) fn image(&self, z: &Tensor) -> Tensor {
        self.image.forward(z)
    }

    /// H_m: `[..., d]` to `[..., M]`.
    pub(crate) fn proprioception(&self, z: &Tensor) -> Tensor {
        self.proprioception.forward(z)
    }

    /// H_a: `[..., d]` to `[..., A]`.
    pub(crate) fn action(&self, z: &Tensor) -> Tensor {
        self.action.forward(z)
    }
}
