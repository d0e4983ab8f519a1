//! The layers with the largest products, which are computed in the precision of the pass; f32 outside of training.
//! Plain layers and their shapes.

use tch::Tensor;
use tch::nn::{self, Module};

use crate::precision::product;

/// A linear layer.
#[derive(Debug)]
pub(super) struct Linear(nn::Linear);

impl Linear {
    /// A layer with a bias, `[…, inputs]` to `[…, outputs]`.
    pub(super) fn new(path: nn::Path<'_>, inputs: i64, outputs: i64) -> Self {
        Self(nn::linear(path, inputs, outputs, Default::default()))
    }
}

impl Module for Linear {
    fn forward(&self, x: &Tensor) -> Tensor {
        let nn::Linear { ws, bs } = &self.0;
        product((x, ws, bs.as_ref()), |x, weights, bias| x.linear(weights, bias))
    }
}

/// A convolution without bias.
#[derive(Debug)]
pub(super) struct Convolution {
    layer: nn::Conv2D,
    stride: i64,
    padding: i64,
}

impl Convolution {
    /// `[N, inputs, H, W]` to `[N, outputs, ⌈H / stride⌉, ⌈W / stride⌉]`, for an odd `kernel`.
    pub(super) fn new(path: nn::Path<'_>, [inputs, outputs, kernel, stride]: [i64; 4]) -> Self {
        let padding = kernel / 2;
        let config = nn::ConvConfig { stride, padding, bias: false, ..Default::default() };
        Self { layer: nn::conv2d(path, inputs, outputs, kernel, config), stride, padding }
    }
}

impl Module for Convolution {
    fn forward(&self, x: &Tensor) -> Tensor {
        let (stride, padding) = ([self.stride; 2], [self.padding; 2]);
        product((x, &self.layer.ws, None), |x, kernels, bias| x.conv2d(kernels, bias, stride, padding, [1, 1], 1))
    }
}
