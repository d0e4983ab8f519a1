//! Groups of settings that several kinds of jobs share.

use crate::schema::{integer_in, number_in};
use crate::settings::Words as _;

crate::words! {
    /// Size of a model.
    pub enum Preset {
        /// 64 wide, 2 layers: for tests, demos and images up to about 64 pixels a side.
        Tiny = "tiny",
        /// 128 wide, 4 layers: for 128-pixel images on a few CPU cores or a small GPU.
        Small = "small",
        /// 256 wide, 4 layers: for a GPU.
        Base = "base",
    }
}

crate::words! {
    /// Where tensors live.
    pub enum Device {
        /// The processor: numbers repeat bit for bit.
        Cpu = "cpu",
        /// The first CUDA device: faster, numbers repeat only nearly.
        Cuda = "cuda",
    }
}

crate::settings! {
    /// The size of a model that has no history.
    #[derive(Copy)]
    pub struct SizeSpec {
        /// Size of the model; larger models need more data, memory and time.
        pub preset: Preset = Preset::Tiny, Preset::shape();
    }
}

crate::settings! {
    /// The size of a transformer and its history.
    #[derive(Copy)]
    pub struct ModelSpec {
        /// Size of the model; larger models need more data, memory and time.
        pub preset: Preset = Preset::Tiny, Preset::shape();
        /// Steps before the newest one in a segment (the paper's l); a segment has one step more.
        pub segment_length: u32 = 6, integer_in(0, 63);
    }
}

impl ModelSpec {
    /// Steps in a segment, `l + 1`.
    #[must_use]
    pub fn window(&self) -> usize {
        self.segment_length as usize + 1
    }
}

crate::settings! {
    /// Random changes to the images of a training batch; none by default. All frames of one episode in a batch change
    /// alike, so that motion between them is preserved.
    #[derive(Copy)]
    pub struct Augmentation {
        /// Shift images by up to this many pixels along each axis, with the edge repeated (0: never).
        pub shift_pixels: u32 = 0, integer_in(0, 1024);
        /// Brighten or darken images by up to this part of full scale (0: never).
        pub brightness: f64 = 0.0, number_in(0.0, 1.0);
        /// Stretch colours about the image's mean by a factor within 1 ± this (0: never).
        pub contrast: f64 = 0.0, number_in(0.0, 1.0);
    }
}

crate::settings! {
    /// The optimiser and the batches: AdamW with a linear warm-up and a cosine decay to zero.
    #[derive(Copy)]
    pub struct OptimSpec {
        /// Gradient steps.
        pub steps: u64 = 2_000, integer_in(1, u32::MAX.into());
        /// Segments in a batch; larger batches give smoother gradients and slower steps.
        pub batch: u32 = 64, integer_in(1, 65_536);
        /// Consecutive segments drawn together, which share encoded frames; more is faster, fewer makes a batch more
        /// varied.
        pub stretch: u32 = 8, integer_in(1, 65_536);
        /// Highest learning rate, reached after the warm-up.
        pub learning_rate: f64 = 1e-3, number_in(1e-12, 10.0);
        /// Decoupled weight decay of matrices (0: none); biases, norms and embeddings have none.
        pub weight_decay: f64 = 0.01, number_in(0.0, 10.0);
        /// Steps over which the learning rate rises from zero.
        pub warmup_steps: u64 = 50, integer_in(0, u32::MAX.into());
        /// Largest global gradient norm; larger gradients are scaled down to it.
        pub clip_norm: f64 = 1.0, number_in(1e-12, 1e12);
    }
}

impl OptimSpec {
    /// The learning rate of `step` (from 0): linear warm-up times a cosine that ends at zero.
    #[must_use]
    pub fn learning_rate_at(&self, step: u64) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "step counts are far below 2^52")]
        let (done, total, warmup) = (step as f64, self.steps as f64, self.warmup_steps.max(1) as f64);
        let rise = ((done + 1.0) / warmup).min(1.0);
        let fall = 0.5 * (1.0 + (std::f64::consts::PI * done / total).cos());
        self.learning_rate * rise * fall
    }
}

crate::settings! {
    /// How a training run is carried out.
    #[derive(Copy)]
    pub struct RunSpec {
        /// Seed of all random numbers.
        pub seed: u64 = 0, integer_in(0, u64::MAX);
        /// Steps between checkpoints; an interrupted job resumes from the last one.
        pub checkpoint_every: u32 = 500, integer_in(1, u32::MAX.into());
        /// Where the job computes.
        pub device: Device = Device::Cpu, Device::shape();
    }
}
