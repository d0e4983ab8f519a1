//! What a policy looks at, as its training reports it in the metrics of its last step.
//!
//! Plain data: must not know networks or pages.

use serde::{Deserialize, Serialize};

use crate::CameraSpec;
use crate::job::Metric;

/// The first part of the names of such metrics.
pub const PREFIX: &str = "share_";

/// The share of a policy's action that one input explains.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Look {
    /// `images`, `camera NAME`, `proprioception` or `history`.
    pub input: String,
    /// Near 0: the action ignores the input; near 1: nothing else matters. Inputs depend on each other, so shares need
    /// not add up to 1.
    pub share: f64,
}

/// The newest share of each input, in the order in which they are reported; other metrics are left out.
#[must_use]
pub fn looks(metrics: &[Metric], cameras: &[CameraSpec]) -> Vec<Look> {
    let mut looks: Vec<Look> = Vec::new();
    for metric in metrics {
        let Some(name) = metric.name.strip_prefix(PREFIX) else { continue };
        let camera = name.strip_prefix("camera_").and_then(|number| cameras.get(number.parse::<usize>().ok()?));
        let input = camera.map_or_else(|| name.to_owned(), |camera| format!("camera {}", camera.name));
        looks.retain(|look| look.input != input);
        looks.push(Look { input, share: metric.value });
    }
    looks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_shares_are_named_by_their_inputs() {
        let metric = |name: &str, value| Metric { sequence: 0, step: 1, name: name.into(), value };
        let metrics = [
            metric("loss", 3.0),
            metric("share_images", 0.2),
            metric("share_images", 0.4),
            metric("share_camera_1", 0.1),
            metric("share_camera_7", 0.3),
            metric("share_proprioception", 0.9),
        ];
        let camera = |name: &str| CameraSpec { name: name.into(), height: 8, width: 8, depth: false, recorded: None };
        let found = looks(&metrics, &[camera("top"), camera("hand")]);
        let found: Vec<(&str, f64)> = found.iter().map(|look| (look.input.as_str(), look.share)).collect();
        assert_eq!(found, [("images", 0.4), ("camera hand", 0.1), ("camera_7", 0.3), ("proprioception", 0.9)]);
    }
}
