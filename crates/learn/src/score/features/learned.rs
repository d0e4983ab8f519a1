//! z^o, z^m, z^a of the unmasked pass: of the last step, z_{i+l}, or of all the segment's steps z_i … z_{i+l},
//! concatenated.

use tch::Tensor;

use super::{CHUNK, Encoder, Episode, Features, extend, lay_out, padding};
use crate::batch::Windows;
use crate::error::LearnError;
use crate::model::Modality;

/// The features of each segment's last `keep` steps: per modality `keep` times d values, zero for places before the
/// episode.
pub(super) fn features(encoder: Encoder<'_>, mut episode: Episode<'_>, keep: usize) -> Result<Features, LearnError> {
    let network = encoder.network;
    let steps = Tensor::cat(&episode.each(|chunk| network.batch_steps(chunk))?, 0);
    let mut features = Features::empty([keep * network.width(); 3]);
    for chunk in episode.every.chunks(CHUNK) {
        let (windows, needed) = lay_out(network, chunk);
        let steps = steps.index_select(0, &needed);
        extend(&mut features, &pass(encoder, &steps, &windows, keep));
    }
    Ok(features)
}

/// The features of windows over encoded `steps`, of their last `keep` steps: o, m, a, each `[W, keep d]`.
pub(super) fn pass(encoder: Encoder<'_>, steps: &Tensor, windows: &Windows, keep: usize) -> [Tensor; 3] {
    let Encoder { network, scale, view } = encoder;
    let z = network.features(steps, windows, view, keep);
    // The last step is always inside the episode; some of the others may be padding.
    let padding = padding(windows, keep);
    [Modality::Image, Modality::Proprioception, Modality::Action].map(|modality| {
        let z = modality.of(&z);
        let z = scale.map_or(z.shallow_clone(), |scale| scale.apply(modality as usize, &z));
        z.masked_fill(&padding, 0.0).flatten(1, -1)
    })
}
