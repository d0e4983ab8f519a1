//! The sizes behind each preset.

use gleaner_core::Preset;

/// Sizes of the network's parts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Size {
    /// Width d of tokens and features.
    pub(crate) width: i64,
    /// Transformer blocks.
    pub(crate) layers: usize,
    /// Attention heads; divides the width.
    pub(crate) heads: i64,
    /// Channels of the image encoder's stages; the last repeats if an image needs more stages.
    pub(crate) channels: &'static [i64],
    /// Longest side of the image that H_o predicts.
    pub(crate) target: u32,
}

impl Size {
    /// The sizes of `preset`.
    pub(crate) fn of(preset: Preset) -> Self {
        match preset {
            Preset::Tiny => Self { width: 64, layers: 2, heads: 4, channels: &[16, 32], target: 8 },
            Preset::Small => Self { width: 128, layers: 4, heads: 4, channels: &[32, 64], target: 16 },
            Preset::Base => Self { width: 256, layers: 4, heads: 8, channels: &[64, 128], target: 16 },
            Preset::Large => Self { width: 384, layers: 6, heads: 8, channels: &[64, 128], target: 16 },
        }
    }
}
