//! What the metrics of a training warn of: a policy that does not switch, or does not look. Must not know a server.

use std::collections::BTreeMap;

use gleaner_proto::v1::{Job, job_spec::Spec};
use prost_types::value::Kind;

use crate::words;

/// The share of the switches of experts that a policy follows.
const FOLLOWED: &str = "switches_followed";
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

/// Whether there is a warning.
pub(super) fn has(metrics: &BTreeMap<String, f64>) -> bool {
    !all(metrics, &[], &Job::default()).is_empty()
}

/// The warnings about a training, with the names of the task's cameras in its order.
pub(super) fn all(metrics: &BTreeMap<String, f64>, cameras: &[String], training: &Job) -> Vec<String> {
    let unfollowed = metrics.get(FOLLOWED).and_then(|share| unfollowed(*share, has_switch_weight(training)));
    unfollowed.into_iter().chain(unseen(metrics, cameras, training.total)).collect()
}

/// Whether a training weighs switches already.
fn has_switch_weight(training: &Job) -> bool {
    let Some(Spec::Train(train)) = training.spec.as_ref().and_then(|spec| spec.spec.as_ref()) else { return false };
    let weight = train.settings.as_ref().and_then(|settings| settings.fields.get("switch_weight"));
    matches!(weight.and_then(|weight| weight.kind.as_ref()), Some(Kind::NumberValue(weight)) if *weight > 1.0)
}

/// The warning of a policy that gives the new binary value at this share only of the steps at which experts change one.
fn unfollowed(share: f64, is_weighted: bool) -> Option<String> {
    (share < 0.5).then(|| {
        let weight = if is_weighted { "" } else { "train with `--switch-weight 10`, " };
        format!(
            "at {:.0} % only of the steps at which experts switch a binary action value, such as a gripper's, the policy \
             switches at that step too: it may switch a little later, or never. Try first where neither does harm. If it \
             does not switch, {weight}leave out of the task what an observation shows of that action, such as the joint of \
             a finger, or try `--policy act` or `flow`, which decide some steps ahead",
            share * 100.0
        )
    })
}

/// The warning of a policy whose action hardly depends on its images, or on those of some cameras.
fn unseen(metrics: &BTreeMap<String, f64>, cameras: &[String], steps: u64) -> Option<String> {
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
    use gleaner_proto::v1::{JobSpec, TrainSpec};

    use super::*;

    fn metrics(shares: &[(&str, f64)]) -> BTreeMap<String, f64> {
        shares.iter().map(|(name, share)| ((*name).to_owned(), *share)).collect()
    }

    #[test]
    fn a_policy_that_follows_few_switches_is_a_warning() {
        assert!(!has(&metrics(&[(FOLLOWED, 0.5)])));
        let warnings = all(&metrics(&[(FOLLOWED, 0.06)]), &[], &Job::default());
        assert!(warnings.len() == 1 && warnings[0].starts_with("at 6 % only of the steps"), "{warnings:?}");
        assert!(warnings[0].contains("--switch-weight 10"), "{warnings:?}");
        let weight = prost_types::Value { kind: Some(Kind::NumberValue(10.0)) };
        let settings = prost_types::Struct { fields: [("switch_weight".to_owned(), weight)].into() };
        let train = TrainSpec { settings: Some(settings), ..TrainSpec::default() };
        let training = Job { spec: Some(JobSpec { spec: Some(Spec::Train(train)) }), ..Job::default() };
        let weighted = all(&metrics(&[(FOLLOWED, 0.06)]), &[], &training);
        assert!(!weighted[0].contains("--switch-weight"), "it has one: {weighted:?}");
    }

    #[test]
    fn a_policy_that_ignores_images_is_a_warning_with_the_camera_s_name() {
        let names = ["hand".to_owned(), "front".to_owned()];
        let of = |shares: &[(&str, f64)]| all(&metrics(shares), &names, &Job { total: 2000, ..Job::default() }).pop();
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
