//! What the metrics of a training warn of: a policy that does not look. Must not know a server.

use std::collections::BTreeMap;

use crate::words;

/// The share of its action that images explain.
const IMAGES: &str = "share_images";
/// Share of its action below which a policy looks at an input hardly at all.
const UNSEEN: f64 = 0.01;

/// Fewest steps of a training that is suggested.
const LONG: u64 = 2000;

/// A longer training than one of these steps, on the newest dataset.
pub(super) fn longer(steps: u64) -> String {
    format!("gleaner train --steps {} --batch 32 --wait", steps.saturating_mul(2).max(LONG))
}

/// The warning of a policy whose action hardly depends on its images, or on those of some of the task's cameras, which are
/// named in its order, after a training of this many steps.
pub(super) fn unseen(metrics: &BTreeMap<String, f64>, cameras: &[String], steps: u64) -> Option<String> {
    let few = |name: &str| metrics.get(name).is_some_and(|share| *share < UNSEEN);
    let of_camera = |at: usize| format!("share_camera_{at}");
    let count = (0..).take_while(|at| metrics.contains_key(&of_camera(*at))).count();
    let name = |at: usize| cameras.get(at).map_or_else(|| at.to_string(), |name| format!("`{name}`"));
    let unseen: Vec<String> = (0..count).filter(|at| few(&of_camera(*at))).map(name).collect();
    let what = match (few(IMAGES), unseen.as_slice()) {
        (true, _) => "images explain".to_owned(),
        (false, []) => return None,
        (false, [one]) => format!("the images of the camera {one} explain"),
        (false, several) => format!("the images of each of the cameras {} explain", words::some(several)),
    };
    Some(format!(
        "{what} less than 1 % of the policy's action: it hardly looks at them, which harms nothing where another camera \
         shows the same, and fails where they alone show what to do. A longer training may change that: `{}`",
        longer(steps)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metrics(shares: &[(&str, f64)]) -> BTreeMap<String, f64> {
        shares.iter().map(|(name, share)| ((*name).to_owned(), *share)).collect()
    }

    #[test]
    fn a_policy_that_ignores_images_is_a_warning_with_the_camera_s_name() {
        let names = ["hand".to_owned(), "front".to_owned()];
        let of = |shares: &[(&str, f64)]| unseen(&metrics(shares), &names, 2000);
        assert_eq!(of(&[]), None, "a task without cameras");
        assert_eq!(of(&[(IMAGES, 0.4), ("share_camera_0", 0.4), ("share_camera_1", 0.02)]), None);
        let one = of(&[(IMAGES, 0.4), ("share_camera_0", 0.4), ("share_camera_1", 0.002)]).unwrap();
        assert!(one.starts_with("the images of the camera `front` explain less than 1 %"), "{one}");
        assert!(one.ends_with("`gleaner train --steps 4000 --batch 32 --wait`"), "longer than it was: {one}");
        let two = of(&[(IMAGES, 0.02), ("share_camera_0", 0.004), ("share_camera_1", 0.002)]).unwrap();
        assert!(two.starts_with("the images of each of the cameras `hand`, `front` explain"), "{two}");
        assert!(of(&[(IMAGES, 0.001)]).unwrap().starts_with("images explain less than 1 %"));
    }
}
