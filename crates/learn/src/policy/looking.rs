//! The defaults by which policies look at images. Independent of the kind of policy.

use gleaner_core::Augmentation;

/// The default changes to inputs. A policy that learns from few episodes copies exact positions in place of looking:
/// shifted images and hidden proprioception are worth 36 to 53 points of success in three of four tasks.
pub(super) fn augmentation() -> Augmentation {
    Augmentation { shift_pixels: 2, proprioception_dropout: 0.3, ..Augmentation::default() }
}
