//! The classifier's network: one hidden layer, trained by binary cross-entropy on batches that are
//! half experts' steps and half imperfect ones. Independent of episodes and folds.

use rand::RngExt;
use tch::{Device, Kind, Tensor, no_grad_guard};

use crate::batch::{int, values};
use crate::error::LearnError;
use crate::optimizer::AdamW;
use crate::progress::Progress;
use crate::random::{Purpose, generator};
use gleaner_core::OptimSpec;

/// Gradient steps.
pub(super) const STEPS: u64 = 300;
/// Steps per batch, half of each class.
pub(super) const BATCH: u32 = 256;
const HIDDEN: i64 = 64;

/// A network with one hidden layer, whose output is log-odds.
pub(super) struct Mlp {
    /// `[W, HIDDEN]`, `[HIDDEN]`, `[HIDDEN, 1]`, `[1]`.
    parameters: [Tensor; 4],
}

impl Mlp {
    /// Trains on the steps of `classes`, experts' and imperfect ones, `[N, W]` each. Each `fold` has separate random
    /// numbers of `seed`.
    pub(super) fn train(
        classes: &[Tensor; 2],
        seed: u64,
        fold: usize,
        progress: &mut Progress<'_>,
    ) -> Result<Self, LearnError> {
        let fold = fold as u64;
        let mlp = Self::new(classes[0].size()[1], classes[0].device(), (seed, fold));
        let optim = OptimSpec { steps: STEPS, batch: BATCH, ..OptimSpec::default() };
        let named = (0..).zip(&mlp.parameters).map(|(i, tensor): (u32, _)| (i.to_string(), tensor.shallow_clone()));
        let mut optimizer = AdamW::new(named.collect());
        let half = int(BATCH as usize / 2);
        let device = classes[0].device();
        let truth = Tensor::cat(
            &[Tensor::ones([half], (Kind::Float, device)), Tensor::zeros([half], (Kind::Float, device))],
            0,
        );
        for step in 0..STEPS {
            let mut rng = generator(seed, Purpose::Batch, fold * STEPS + step);
            let mut draw = |class: &Tensor| {
                let places: Vec<i64> = (0..half).map(|_| rng.random_range(0..class.size()[0])).collect();
                class.index_select(0, &Tensor::from_slice(&places).to_device(device))
            };
            let batch = Tensor::cat(&[draw(&classes[0]), draw(&classes[1])], 0);
            optimizer.zero_grad();
            let loss = mlp.log_odds(&batch).binary_cross_entropy_with_logits::<Tensor>(
                &truth,
                None,
                None,
                tch::Reduction::Mean,
            );
            loss.backward();
            optimizer.step(step, optim.learning_rate_at(step), &optim);
            progress.advance(BATCH as usize)?;
        }
        Ok(mlp)
    }

    /// Initial weights uniform with variance 1 / inputs, biases 0.
    fn new(width: i64, device: Device, (seed, fold): (u64, u64)) -> Self {
        let matrix = |inputs: i64, outputs: i64, place: u64| {
            let mut rng = generator(seed, Purpose::Weights, 2 * fold + place);
            #[expect(clippy::cast_precision_loss, reason = "layer sizes are far below 2^52")]
            let bound = (3.0 / inputs as f64).sqrt();
            let drawn: Vec<f64> = (0..inputs * outputs).map(|_| rng.random_range(-bound..bound)).collect();
            Tensor::from_slice(&drawn).to_kind(Kind::Float).view([inputs, outputs])
        };
        let zeros = |width: i64| Tensor::zeros([width], (Kind::Float, Device::Cpu));
        let parameters = [matrix(width, HIDDEN, 0), zeros(HIDDEN), matrix(HIDDEN, 1, 1), zeros(1)];
        Self { parameters: parameters.map(|tensor| tensor.to_device(device).set_requires_grad(true)) }
    }

    /// Log-odds `[N]` of `[N, W]`.
    fn log_odds(&self, inputs: &Tensor) -> Tensor {
        let [up, up_bias, down, down_bias] = &self.parameters;
        let hidden = (inputs.matmul(up) + up_bias).gelu("none");
        (hidden.matmul(down) + down_bias).squeeze_dim(-1)
    }

    /// log p(expert) of every row of `[N, W]`: log σ(x) = min(x, 0) − log(1 + e^−|x|).
    pub(super) fn log_probability(&self, inputs: &Tensor) -> Vec<f64> {
        let _no_grad = no_grad_guard();
        let odds = values(&self.log_odds(inputs));
        odds.iter().map(|x| f64::from(*x)).map(|x| x.min(0.0) - (-x.abs()).exp().ln_1p()).collect()
    }
}
