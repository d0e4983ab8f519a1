//! What a policy looks at: the shares of its action that its inputs explain. Independent of the kind of policy.
//!
//! The share of an input is its total Sobol index by Jansen's estimator: E[(f(x) − f(x′))²] / 2 Var f(x), where x′ is x
//! with that input taken from a segment of another episode. 0: the action ignores the input; 1: nothing else matters.
//! The inputs overlap (the history has images too) and depend on each other, so shares need not add up to 1.

use rand::RngExt;
use tch::{Kind, Tensor, no_grad_guard};

use super::kind::{PolicyInput, PolicyModel};
use super::source::Source;
use crate::batch::{Batch, Segment, Windows, int};
use crate::error::LearnError;
use crate::random::{Purpose, generator};
use crate::train::Metrics;

/// Pairs of segments: enough for a standard error of a few hundredths.
const PAIRS: usize = 128;
/// Frames of a camera in a pass, at least one window of them: as few as a step of serving or validation has, so that the
/// report needs no more memory than the training before it.
const FRAMES: usize = 64;
/// Action values that vary less than this part of a standard deviation are constant.
const STILL: f64 = 1e-6;
/// The metric of each camera; a task has at most that many.
const CAMERAS: [&str; 16] = [
    "share_camera_0",
    "share_camera_1",
    "share_camera_2",
    "share_camera_3",
    "share_camera_4",
    "share_camera_5",
    "share_camera_6",
    "share_camera_7",
    "share_camera_8",
    "share_camera_9",
    "share_camera_10",
    "share_camera_11",
    "share_camera_12",
    "share_camera_13",
    "share_camera_14",
    "share_camera_15",
];

/// The inputs of whole windows, laid out one after the other: W windows over W L steps.
pub(super) struct Inputs {
    pub(super) images: Vec<Tensor>,
    pub(super) proprioception: Tensor,
    pub(super) action: Tensor,
}

/// The shares as metrics: `share_images`, `share_camera_0` … in the order of the task's cameras (with several cameras),
/// `share_proprioception`, and `share_history` (the images, proprioception and actions of the steps before the newest,
/// for a policy with a history). Empty if no two episodes have a whole window. `hides_history`: the policy acts with the
/// past hidden.
pub(super) fn shares(
    policy: &dyn PolicyModel,
    source: &Source<'_>,
    hides_history: bool,
    seed: u64,
) -> Result<Metrics, LearnError> {
    shares_by(policy, source, hides_history, (seed, FRAMES))
}

fn shares_by(
    policy: &dyn PolicyModel,
    source: &Source<'_>,
    hides_history: bool,
    (seed, frames): (u64, usize),
) -> Result<Metrics, LearnError> {
    let _no_grad = no_grad_guard();
    let window = policy.info().window;
    let [ours, theirs] = pairs(source, window, seed);
    let mut acted: Vec<(&'static str, Vec<Tensor>)> = Vec::new();
    let (size, mut done) = ((frames / window).max(1), 0);
    for (ours, theirs) in ours.chunks(size).zip(theirs.chunks(size)) {
        let (own, other) = (inputs(policy, source, ours)?, inputs(policy, source, theirs)?);
        for (at, (name, changed)) in changes(&own, &other, window).into_iter().enumerate() {
            let Inputs { images, proprioception, action } = changed;
            let first = first_actions(policy, (&images, &proprioception, &action), hides_history, (seed, done));
            if at == acted.len() {
                acted.push((name, Vec::new()));
            }
            acted[at].1.push(first.to_kind(Kind::Double));
        }
        done += ours.len() as u64;
    }
    let mut acted = acted.into_iter().map(|(name, chunks)| (name, Tensor::cat(&chunks, 0)));
    let Some((_, base)) = acted.next() else { return Ok(Vec::new()) };
    let variance = base.var_dim([0i64].as_slice(), false, false);
    let moving = variance.gt(STILL).to_kind(Kind::Double) * policy.info().statistics.moves();
    let share = |changed: Tensor| {
        let change = (changed - &base).square().mean_dim([0i64].as_slice(), false, Kind::Double);
        let each = change / (variance.clamp_min(STILL) * 2.0) * &moving;
        each.sum(Kind::Double).double_value(&[]) / moving.sum(Kind::Double).double_value(&[]).max(1.0)
    };
    Ok(acted.map(|(name, changed)| (name, share(changed))).collect())
}

/// The inputs as they are, and then with each part in turn taken from the others, under the metric of its share.
fn changes(ours: &Inputs, theirs: &Inputs, window: usize) -> Vec<(&'static str, Inputs)> {
    let cameras = ours.images.len();
    let with_images = |swaps: &dyn Fn(usize) -> bool| {
        let image = |at: usize| if swaps(at) { &theirs.images[at] } else { &ours.images[at] }.shallow_clone();
        Inputs {
            images: (0..cameras).map(image).collect(),
            proprioception: ours.proprioception.shallow_clone(),
            action: ours.action.shallow_clone(),
        }
    };
    let mut changes = vec![("", with_images(&|_| false)), ("share_images", with_images(&|_| true))];
    for (camera, name) in CAMERAS.into_iter().enumerate().take(if cameras > 1 { cameras } else { 0 }) {
        changes.push((name, with_images(&|at| at == camera)));
    }
    let proprioception = theirs.proprioception.shallow_clone();
    changes.push(("share_proprioception", Inputs { proprioception, ..with_images(&|_| false) }));
    if window > 1 {
        let past = |ours: &Tensor, theirs: &Tensor| {
            let each = |all: &Tensor| all.unflatten(0, [-1, int(window)]);
            let (past, newest) = (each(theirs).narrow(1, 0, int(window) - 1), each(ours).narrow(1, int(window) - 1, 1));
            Tensor::cat(&[past, newest], 1).flatten(0, 1)
        };
        changes.push((
            "share_history",
            Inputs {
                images: ours.images.iter().zip(&theirs.images).map(|(a, b)| past(a, b)).collect(),
                proprioception: past(&ours.proprioception, &theirs.proprioception),
                action: past(&ours.action, &theirs.action),
            },
        ));
    }
    changes
}

/// The first actions after whole windows of images, proprioception and actions, laid out as in [`Inputs`]: standardised,
/// `[W, A]`. A policy that draws its actions draws those of window i with the number `from` + i.
pub(super) fn first_actions(
    policy: &dyn PolicyModel,
    (images, proprioception, action): (&[Tensor], &Tensor, &Tensor),
    hides_history: bool,
    (seed, from): (u64, u64),
) -> Tensor {
    let window = policy.info().window;
    let valid = vec![true; usize::try_from(proprioception.size()[0]).unwrap_or(0)];
    let count = valid.len() / window;
    let windows = Windows::in_order(valid, window, proprioception.device());
    let input = PolicyInput {
        embedded: policy.embed_images(images),
        proprioception: proprioception.shallow_clone(),
        action: action.shallow_clone(),
        hidden: policy.history().hidden(&windows, &vec![hides_history; count]),
        windows,
        before: 0,
        draws: (from..).take(count).map(|segment| (seed, segment)).collect(),
    };
    policy.act(&input).select(1, 0)
}

/// Segments with whole windows, and for each one of another episode.
fn pairs(source: &Source<'_>, window: usize, seed: u64) -> [Vec<Segment>; 2] {
    let at = |place| source.segments.at(place);
    let whole: Vec<usize> = (0..source.segments.count()).filter(|place| at(*place).step + 1 >= window).collect();
    let mut pairs = [Vec::new(), Vec::new()];
    let several = whole.iter().any(|place| at(*place).trajectory != at(whole[0]).trajectory);
    let mut rng = generator(seed, Purpose::Shares, 0);
    while several && pairs[0].len() < PAIRS {
        let [ours, theirs] = [(); 2].map(|()| at(whole[rng.random_range(0..whole.len())]));
        if ours.trajectory != theirs.trajectory {
            pairs[0].push(ours);
            pairs[1].push(theirs);
        }
    }
    pairs
}

/// Every place of the segments' windows, each window with steps of its own.
pub(super) fn inputs(
    policy: &dyn PolicyModel,
    source: &Source<'_>,
    segments: &[Segment],
) -> Result<Inputs, LearnError> {
    let info = policy.info();
    let batch = Batch::collect(info.shape, &source.data, segments, info.window, info.device)?;
    let spread = |steps: &Tensor| steps.index_select(0, &batch.windows.index);
    Ok(Inputs {
        images: batch.images.iter().map(spread).collect(),
        proprioception: spread(&batch.proprioception),
        action: spread(&batch.action),
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::super::tests::{forms, kind_of, untrained};
    use super::*;
    use crate::batch::Segments;
    use crate::toy;
    use crate::trajectory::Trajectory;

    fn of(kind: &str, data: &[&Trajectory]) -> BTreeMap<&'static str, f64> {
        let policy = untrained(kind, data);
        let source = Source { segments: Segments::every(data), data: data.to_vec() };
        shares(policy.as_ref(), &source, false, 1).unwrap().into_iter().collect()
    }

    #[test]
    fn every_policy_looks_at_its_inputs_and_at_nothing_else() {
        let experts = toy::experts(4, 9);
        let data: Vec<&Trajectory> = experts.iter().collect();
        for kind in forms() {
            let found = of(kind, &data);
            let looks = kind_of(kind).needs.images;
            // Before training, most of an action that is drawn from noise is the noise.
            assert_eq!(found["share_images"] > 1e-5, looks, "{kind}: {found:?}");
            assert!(found["share_proprioception"] > 1e-3, "{kind}: {found:?}");
            if !looks {
                let alone = found["share_proprioception"];
                assert!((0.7..1.3).contains(&alone), "{kind}: nothing else explains its action: {alone}");
            }
            let remembers = kind_of(kind).needs.history;
            assert_eq!(found.contains_key("share_history"), remembers, "{kind}");
        }
    }

    #[test]
    fn shares_do_not_depend_on_the_frames_in_a_pass() {
        let experts = toy::experts(4, 9);
        let data: Vec<&Trajectory> = experts.iter().collect();
        for kind in forms() {
            let policy = untrained(kind, &data);
            let source = Source { segments: Segments::every(&data), data: data.clone() };
            let found = |frames| shares_by(policy.as_ref(), &source, false, (1, frames)).unwrap();
            for ((name, one), (also, whole)) in found(1).into_iter().zip(found(usize::MAX)) {
                assert!(
                    name == also && (one - whole).abs() < 1e-3 * whole.abs().max(1e-3),
                    "{kind} {name}: {one} {whole}"
                );
            }
        }
    }

    #[test]
    fn action_values_that_are_held_explain_nothing() {
        let still = |expert: &Trajectory| expert.changed(|arrays| arrays.action.fill(0.25));
        let experts: Vec<Trajectory> = toy::experts(4, 9).iter().map(still).collect();
        let data: Vec<&Trajectory> = experts.iter().collect();
        for kind in forms() {
            let found = of(kind, &data);
            assert!(found.values().all(|share| *share == 0.0), "{kind}: every action is served as 0.25: {found:?}");
        }
    }

    #[test]
    fn a_single_episode_explains_nothing() {
        let data = toy::episode("e", 1, 9, true);
        assert!(of("bc", &[&data]).is_empty());
    }
}
