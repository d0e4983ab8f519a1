//! Groups of settings that several kinds of jobs share.

use crate::schema::{Problem, Setting, integer_in, number_in};
use crate::settings::{Group as _, Words as _};

crate::words! {
    /// Size of a model.
    pub enum Preset {
        /// 64 wide, 2 layers: for tests, demos and images up to about 64 pixels a side.
        Tiny = "tiny",
        /// 128 wide, 4 layers: for 128-pixel images on a few CPU cores or a small GPU.
        Small = "small",
        /// 256 wide, 4 layers: for a GPU.
        Base = "base",
        /// 384 wide, 6 layers: for a large GPU and thousands of episodes.
        Large = "large",
    }
}

crate::words! {
    /// The network that reads images.
    pub enum ImageEncoder {
        /// Two or three convolutions: fast, and enough where objects differ in colour.
        Keypoints = "keypoints",
        /// A residual network whose every output sees a whole picture of 128×128 pixels: 0.3 million parameters with the
        /// preset tiny, 2.8 with small, 11 with base (ResNet-18), 21 with large (ResNet-34). Slower by far.
        Residual = "residual",
        /// ResNet-18 as torchvision lays it out, 11 million parameters: begins with the weights that `image_weights`
        /// names, pretrained on ImageNet's photographs. Shrinks images by 32, so small ones leave few places for
        /// keypoints. Norms never change. The weights for depth begin at zero.
        Resnet18 = "resnet18",
        /// ResNet-34, 21 million parameters: as `resnet18`, slower.
        Resnet34 = "resnet34",
    }
}

crate::words! {
    /// Where tensors live.
    pub enum Device {
        /// The processor: results repeat bit for bit.
        Cpu = "cpu",
        /// The first CUDA device: faster; results repeat only approximately.
        Cuda = "cuda",
    }
}

crate::words! {
    /// The token that a transformer's action is read from.
    pub enum ActionToken {
        /// The newest proprioception token. Its residual stream is the proprioception.
        Proprioception = "proprioception",
        /// A query of its own after the newest proprioception: it attends to images and proprioception alike.
        Query = "query",
        /// A query that a small perceptron makes of the newest images and proprioception together, as behaviour cloning
        /// reads them; attention adds the history.
        Fused = "fused",
        /// The newest image token, together with the images' embedding and the proprioception as they are before
        /// attention, through a perceptron like that of behaviour cloning: the policy sees what behaviour cloning sees,
        /// and attention adds the history.
        Image = "image",
    }
}

crate::settings! {
    /// The size of a model, and of the history that a transformer sees.
    #[derive(Copy)]
    pub struct ModelSpec {
        /// Size of the model. Larger models fit finer structure and need more data, memory and time.
        pub preset: Preset = Preset::Tiny, Preset::shape();
        /// Steps of a segment before its newest one (the paper's l; 0: the newest step alone). Longer segments see more
        /// history and need more time and memory.
        pub segment_length: u32 = 6, integer_in(0, 63);
        /// Network that reads images. Its last layer finds keypoints either way.
        pub image_encoder: ImageEncoder = ImageEncoder::Keypoints, ImageEncoder::shape();
        /// Token that the action is read from. In pretraining, the objective `aa` alone trains the query of `query` and
        /// `fused` and the perceptron of `image`: from an encoder without `aa`, `finetune` begins with untrained ones.
        pub action_token: ActionToken = ActionToken::Image, ActionToken::shape();
        /// Factor on the initial weights of the layer that finds keypoints in images (the softmax over places). At 1
        /// every keypoint begins near the middle of the image and hardly depends on it; from about 5 it begins at the
        /// one place that stands out, and a transformer looks, together with `proprioception_dropout`. Far higher
        /// factors leave it no gradient.
        pub keypoint_gain: f64 = 1.0, number_in(1e-3, 1e3);
    }
}

crate::words! {
    /// Origin of a policy's first weights.
    pub enum InitialWeights {
        /// Random numbers, drawn by the seed.
        Random = "random",
        /// A pretrained encoder: its image encoder, and its transformer if the policy sees a history.
        Encoder = "encoder",
    }
}

crate::settings! {
    /// The steps that a policy sees, and its initial weights.
    #[derive(Copy)]
    pub struct ObserverSpec {
        /// First weights of what reads the observations. A pretrained encoder gives the size of the model too.
        pub initial_weights: InitialWeights = InitialWeights::Random, InitialWeights::shape();
        /// Steps before the newest one that the policy sees, through a causal transformer (0: the newest step alone,
        /// without one). Beginning from an encoder: 0, or the encoder's segment_length.
        pub history_steps: u32 = 0, integer_in(0, 63);
    }
}

impl ModelSpec {
    /// The settings of a model whose input is one step.
    #[must_use]
    pub fn schema_of_one_step() -> Vec<Setting> {
        let of_windows = ["segment_length", "action_token"];
        Self::schema().into_iter().filter(|setting| !of_windows.contains(&setting.name.as_str())).collect()
    }

    /// Steps in a segment, `l + 1`.
    #[must_use]
    pub fn window(&self) -> usize {
        self.segment_length as usize + 1
    }
}

crate::settings! {
    /// Random changes to the inputs of a training batch; off by default in pretraining. All images of one episode in a
    /// batch change alike, so that motion between them is preserved; proprioception changes at each step.
    #[derive(Copy)]
    pub struct Augmentation {
        /// Shift images randomly by up to this many pixels along each axis; edge pixels are repeated (0: off). Larger
        /// shifts tolerate a moved camera but blur the positions of objects.
        pub shift_pixels: u32 = 0, integer_in(0, 1024);
        /// Brighten or darken images randomly by up to this fraction of full scale (0: off). Higher values tolerate
        /// changes of light but saturate more pixels.
        pub brightness: f64 = 0.0, number_in(0.0, 1.0);
        /// Scale colours around the image's mean by a random factor within 1 ± this value (0: off). Higher values
        /// tolerate changes of light but saturate more pixels.
        pub contrast: f64 = 0.0, number_in(0.0, 1.0);
        /// Shift each proprioception value of each step by normal noise of this many standard deviations (0: off).
        /// Higher values make a policy rely on images, and less on exact positions.
        pub proprioception_noise: f64 = 0.0, number_in(0.0, 100.0);
        /// Chance of replacing the proprioception of a step by its mean (0: off), so that the images have to suffice.
        /// Higher values make a policy look more, and learn less from exact positions.
        pub proprioception_dropout: f64 = 0.0, number_in(0.0, 1.0);
    }
}

crate::words! {
    /// Course of the learning rate after the warm-up.
    pub enum RateSchedule {
        /// Falls to zero along a cosine.
        Cosine = "cosine",
        /// Stays at the peak.
        Constant = "constant",
    }
}

crate::words! {
    /// Weights of a finished model.
    pub enum FinishedWeights {
        /// Those of the last step.
        Last = "last",
        /// The exponential moving average of all steps, steadier than any single step; only the last metrics are of it.
        Ema = "ema",
        /// The mean of the weights at five late steps, a twentieth of the run apart, the last step among them. The paper
        /// averages the results of five late checkpoints; a mean of weights is one policy with one result.
        Mean = "mean",
        /// Those with the lowest `loss_validation`, which is measured up to twenty times; needs a `validation_share` above 0.
        Best = "best",
    }
}

crate::settings! {
    /// Episodes that are held out.
    pub(super) struct Validation {
        /// Share of the episodes, drawn by the seed, that are held out of training to report `loss_validation` on (0: none):
        /// of the experts for a policy, of all episodes in pretraining. It is rounded down to whole episodes, so that 0.05 of
        /// fewer than 20 holds none out, or one for `finished_weights best`. A larger share measures overfitting better and
        /// leaves fewer episodes to learn from.
        pub(super) validation_share: f64 = 0.05, number_in(0.0, 0.9);
    }
}

impl Validation {
    /// The default of pretraining, whose encoder scores every episode: those that it has not learned from would look worse.
    pub(super) const NONE: Self = Self { validation_share: 0.0 };

    /// The share, if `finished` can be had with it.
    pub(super) fn checked(self, finished: FinishedWeights) -> Result<f64, Problem> {
        if finished == FinishedWeights::Best && self.validation_share == 0.0 {
            return Err(Problem::new("finished_weights", "best needs a validation_share above 0"));
        }
        Ok(self.validation_share)
    }
}

crate::words! {
    /// Precision of the products of a training.
    pub enum Precision {
        /// Single precision throughout, as in serving and scoring.
        F32 = "f32",
        /// Factors of convolutions and transformer blocks in bfloat16, which has three digits, with sums in single precision.
        /// Weights, attention, heads, losses
        /// and the optimiser stay f32. Faster on processors with AVX-512 BF16 or AMX and on GPUs, slower on others.
        Bf16 = "bf16",
        /// TF32 of NVIDIA's GPUs from Ampere on: three digits of the factors, with sums in single precision, in every
        /// product. Faster there; on processors it is f32.
        Tf32 = "tf32",
    }
}

crate::settings! {
    /// The optimiser and the batches: AdamW with a linear warm-up.
    #[derive(Copy)]
    pub struct OptimSpec {
        /// Number of gradient steps. More steps fit the data closer, up to overfitting, and take longer.
        pub steps: u64 = 2_000, integer_in(1, u32::MAX.into());
        /// Segments in a batch. Larger batches give smoother gradients; each step takes more time and memory.
        pub batch: u32 = 64, integer_in(1, 65_536);
        /// Consecutive segments drawn together, which share encoded frames. Longer stretches are faster; shorter ones
        /// make a batch more varied.
        pub stretch: u32 = 8, integer_in(1, 65_536);
        /// Peak learning rate, reached after the warm-up. Higher rates learn faster but may diverge.
        pub learning_rate: f64 = 1e-3, number_in(1e-12, 10.0);
        /// Course of the learning rate after the warm-up.
        pub rate_schedule: RateSchedule = RateSchedule::Cosine, RateSchedule::shape();
        /// Learning rate of the image encoder as a multiple of `learning_rate` (0: its weights stay as they are).
        /// Higher values adapt the images' features faster but may forget pretrained ones.
        pub image_rate_factor: f64 = 1.0, number_in(0.0, 1e3);
        /// Decoupled weight decay of matrices (0: none); biases, norms and embeddings are exempt. Higher values reduce
        /// overfitting but limit the fit.
        pub weight_decay: f64 = 0.01, number_in(0.0, 10.0);
        /// Steps over which the learning rate rises from zero (0: no warm-up). A longer warm-up is more stable but
        /// leaves fewer steps at a high rate.
        pub warmup_steps: u64 = 50, integer_in(0, u32::MAX.into());
        /// Maximum global gradient norm; larger gradients are scaled down to it. Lower values are more stable but learn
        /// slower.
        pub clip_norm: f64 = 1.0, number_in(1e-12, 1e12);
        /// Batches whose gradients are averaged for one step (1: each batch is a step). More of them act as a larger
        /// batch in the memory of one, and take proportionally longer.
        pub gradient_accumulation: u32 = 1, integer_in(1, 65_536);
        /// Weights of the finished model.
        pub finished_weights: FinishedWeights = FinishedWeights::Last, FinishedWeights::shape();
        /// Largest decay of the moving average for `ema` (0: the last step). After n steps it is at most 1 − (1 +
        /// n)^−0.75, so that initial weights fade; higher values average over more steps.
        pub ema_decay: f64 = 0.999, number_in(0.0, 0.999_999);
        /// Precision of products in training. Scores and actions are computed
        /// in f32 either way. Lower precision is faster where the hardware has it, but gradients are less exact.
        pub precision: Precision = Precision::F32, Precision::shape();
    }
}

impl OptimSpec {
    /// The settings whose defaults in a training depend on its policy, with these values as defaults: each policy lists
    /// them. A spec has them here.
    #[must_use]
    pub fn of_policy(&self) -> Vec<Setting> {
        self.as_defaults().into_iter().filter(|setting| Self::is_of_policy(&setting.name)).collect()
    }

    pub(super) fn is_of_policy(name: &str) -> bool {
        ["stretch", "learning_rate"].contains(&name)
    }

    /// The learning rate of `step` (from 0): linear warm-up times the schedule, whose cosine ends at zero.
    #[must_use]
    pub fn learning_rate_at(&self, step: u64) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "step counts are far below 2^52")]
        let (done, total, warmup) = (step as f64, self.steps as f64, self.warmup_steps.max(1) as f64);
        let rise = ((done + 1.0) / warmup).min(1.0);
        let fall = match self.rate_schedule {
            RateSchedule::Cosine => 0.5 * (1.0 + (std::f64::consts::PI * done / total).cos()),
            RateSchedule::Constant => 1.0,
        };
        self.learning_rate * rise * fall
    }
}

crate::settings! {
    /// How a training run is carried out.
    #[derive(Copy)]
    pub struct RunSpec {
        /// Seed of all random numbers. Equal seeds repeat a run for equal inputs and number of threads.
        pub seed: u64 = 0, integer_in(0, u64::MAX);
        /// Steps between checkpoints; an interrupted job resumes from the last one. Shorter intervals lose less work
        /// but write more.
        pub checkpoint_every: u32 = 500, integer_in(1, u32::MAX.into());
        /// Device of the computation.
        pub device: Device = Device::Cpu, Device::shape();
    }
}
