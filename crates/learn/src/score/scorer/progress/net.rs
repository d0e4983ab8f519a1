//! The network of progress: a small causal transformer over the frames of a clip, trained by the squared error of each
//! frame's progress. Independent of episodes, folds and scores.

use tch::nn::{self, Module, VarStore};
use tch::{Device, Kind, Tensor, no_grad_guard};

use super::ProgressSpec;
use super::clip::{Clip, FRAMES, places};
use crate::batch::{int, values};
use crate::error::LearnError;
use crate::model::{Size, Transformer, weights};
use crate::normalize::Standard;
use crate::optimizer::AdamW;
use crate::progress::Progress;
use crate::random::{Purpose, generator};
use gleaner_core::OptimSpec;
use rand::RngExt;

/// Clips per batch.
pub(super) const BATCH: u32 = 32;
/// Clips whose progress is computed at a time.
const CHUNK: usize = 512;
/// The transformer; it has no image encoder.
const SIZE: Size = Size { width: 128, layers: 2, heads: 4, channels: &[], target: 0 };

/// A trained network with the scale of its inputs.
pub(super) struct Net {
    store: VarStore,
    standard: Standard,
    input: nn::Linear,
    /// `[1, d]`, added to the first frame. Other frames have no position, which would be a clock.
    first: Tensor,
    transformer: Transformer,
    head: nn::Linear,
    /// `[1, 1, 8, 8]` of `bool`: a frame attends to itself and those before it.
    causal: Tensor,
}

impl Net {
    /// Trains on the states of `episodes`, `[T, D]` each with at least [`SHORTEST`](super::clip::SHORTEST) steps. Each
    /// `fold` draws separate clips; initial weights depend on the seed alone.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if the loss is not finite, and [`LearnError::Cancelled`].
    pub(super) fn train(
        episodes: &[&Tensor],
        (spec, seed): (&ProgressSpec, u64),
        fold: u64,
        device: Device,
        progress: &mut Progress<'_>,
    ) -> Result<Self, LearnError> {
        let all = Tensor::cat(episodes, 0);
        let net = Self::new(&all, seed, device);
        let states = net.standard.apply(&all.to_device(device));
        let begins = episodes.iter().scan(0, |next, episode| {
            let begin = *next;
            *next += episode.size()[0];
            Some((begin, usize::try_from(episode.size()[0]).unwrap_or(0)))
        });
        let episodes: Vec<(i64, usize)> = begins.collect();
        let steps = spec.progress_steps;
        let optim =
            OptimSpec { steps, batch: BATCH, weight_decay: 1e-4, warmup_steps: steps / 10, ..OptimSpec::default() };
        let mut optimizer = AdamW::new(weights::sorted(&net.store));
        for step in 0..steps {
            let mut rng = generator(seed, Purpose::Batch, fold * steps + step);
            let (mut frames, mut targets) = (Vec::new(), Vec::new());
            for _ in 0..BATCH {
                let (begin, length) = episodes[rng.random_range(0..episodes.len())];
                let clip = Clip::draw(&mut rng, length);
                frames.extend(clip.frames.map(|frame| begin + int(frame)));
                targets.extend(clip.targets);
            }
            let targets = Tensor::from_slice(&targets).view([-1, int(FRAMES)]).to_device(device);
            optimizer.zero_grad();
            let found = net.forward(&clips(&states, &frames), int(FRAMES));
            // The first frame alone shows no progress.
            let later = |x: &Tensor| x.narrow(1, 1, int(FRAMES) - 1);
            let loss = (later(&found) - later(&targets)).square().mean(Kind::Float);
            loss.backward();
            let norm = optimizer.step(step, optim.learning_rate_at(step), &optim);
            if !(norm.is_finite() && loss.double_value(&[]).is_finite()) {
                let message = format!(
                    "make the loss of the scorer progress not finite at step {step}; leave out episodes that are \
                     far from the encoder's data, or use another scorer"
                );
                return Err(LearnError::invalid("experts", message));
            }
            progress.advance(BATCH as usize)?;
        }
        Ok(net)
    }

    /// The network with initial weights, for inputs like `states`, `[N, D]`.
    fn new(states: &Tensor, seed: u64, device: Device) -> Self {
        let width = states.size()[1];
        let columns = usize::try_from(width).unwrap_or(1);
        let standard = Standard::of_rows(values(states).chunks(columns), columns, device);
        let store = VarStore::new(device);
        let root = store.root() / "progress";
        let linear = |name: &str, from, to| nn::linear(&root / name, from, to, Default::default());
        let (input, head) = (linear("input", width, SIZE.width), linear("head", SIZE.width, 1));
        let first = root.zeros("first_embedding", &[1, SIZE.width]);
        let transformer = Transformer::new(&(&root / "transformer"), &SIZE);
        let causal = Tensor::ones([1, 1, int(FRAMES), int(FRAMES)], (Kind::Bool, device)).tril(0);
        drop(root);
        weights::draw(&weights::sorted(&store), 1.0, seed);
        Self { store, standard, input, first, transformer, head, causal }
    }

    /// Progress in 0 … 1 at the last `keep` frames of each clip: `[C, 8, D]` of standardised states to `[C, keep]`.
    fn forward(&self, clips: &Tensor, keep: i64) -> Tensor {
        let frames = self.input.forward(clips);
        let first = frames.narrow(1, 0, 1) + &self.first;
        let frames = Tensor::cat(&[first, frames.narrow(1, 1, int(FRAMES) - 1)], 1);
        self.head.forward(&self.transformer.last_tokens(&frames, Some(&self.causal), keep)).squeeze_dim(-1).sigmoid()
    }

    /// Progress at every step of an episode with states `[T, D]`, each from the clip that starts with the episode and
    /// ends there.
    pub(super) fn progress(&self, states: &Tensor) -> Vec<f64> {
        let _no_grad = no_grad_guard();
        let states = self.standard.apply(&states.to_device(self.store.device()));
        let steps: Vec<usize> = (0..usize::try_from(states.size()[0]).unwrap_or(0)).collect();
        let of = |chunk: &[usize]| {
            let frames: Vec<i64> = chunk.iter().flat_map(|last| places(last + 1).map(int)).collect();
            values(&self.forward(&clips(&states, &frames), 1))
        };
        steps.chunks(CHUNK).flat_map(of).map(f64::from).collect()
    }
}

/// The states of `frames`, eight for each clip: of `[N, D]`, `[C, 8, D]`.
fn clips(states: &Tensor, frames: &[i64]) -> Tensor {
    states.index_select(0, &Tensor::from_slice(frames).to_device(states.device())).unflatten(0, [-1, int(FRAMES)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::Silent;

    /// States of one value, at these places.
    fn states(places: impl Iterator<Item = f32>) -> Tensor {
        Tensor::from_slice(&places.collect::<Vec<_>>()).view([-1, 1])
    }

    fn line(steps: u16) -> impl DoubleEndedIterator<Item = f32> + Clone {
        (0..steps).map(move |step| f32::from(step) / f32::from(steps))
    }

    fn train(episodes: &[Tensor], steps: u64, seed: u64) -> Result<Net, LearnError> {
        let spec = ProgressSpec { progress_steps: steps, ..ProgressSpec::default() };
        let mut silent = Silent;
        let mut progress = Progress::of_segments(&mut silent, 0);
        Net::train(&episodes.iter().collect::<Vec<_>>(), (&spec, seed), 0, Device::Cpu, &mut progress)
    }

    /// The reference's check: x_t = t / T. A clip that is frozen throughout is the same at every step; one that stops
    /// midway is not, and rests less.
    #[test]
    fn progress_rises_forward_falls_in_reverse_and_rests_when_frozen() {
        let experts: Vec<Tensor> = (20..36).map(|steps| states(line(steps))).collect();
        let net = train(&experts, 120, 1).unwrap();
        let gains = |episode: Tensor| super::super::gains(&net.progress(&episode), 10);
        let forward = gains(states(line(30)));
        let reversed = gains(states(line(30).rev()));
        let frozen = gains(states(std::iter::repeat_n(0.5, 30)));
        let stopped = gains(states(line(30).take(15).chain(std::iter::repeat_n(0.5, 25))));
        // The last ten steps look less far ahead.
        assert!(forward[..20].iter().all(|gain| *gain > 0.1), "{forward:?}");
        assert!(reversed[..20].iter().all(|gain| *gain < 0.0), "{reversed:?}");
        assert!(frozen.iter().all(|gain| gain.abs() < 0.02), "{frozen:?}");
        assert!(stopped[15..].iter().all(|gain| gain.abs() < 0.06), "{stopped:?}");
    }

    #[test]
    fn states_that_are_not_finite_are_refused() {
        let message =
            train(&[states([0.0, 0.1, f32::NAN, 0.3, 0.4].into_iter())], 3, 1).map(|_| ()).unwrap_err().to_string();
        assert!(message.starts_with("experts: make the loss of the scorer progress not finite at step 0"), "{message}");
    }
}
