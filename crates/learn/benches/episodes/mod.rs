//! Episodes of noise for the benches: what tensors cost does not depend on what they show.

use gleaner_core::{ActionToken, Chosen, ModelSpec, Preset, Words as _, kinds::Family};
use gleaner_learn::{CameraShape, TaskShape, Trajectory};

/// Steps of an episode.
const STEPS: usize = 100;

/// A model and a task with two cameras of `side` pixels a side.
pub(crate) fn sizes(preset: Preset, side: u32, depth: bool) -> (ModelSpec, TaskShape) {
    let camera = |name: &str| CameraShape { name: name.into(), height: side, width: side, depth, recorded: None };
    let shape = TaskShape {
        cameras: vec![camera("top"), camera("hand")],
        proprioception: 38,
        action: 7,
        ranges: gleaner_core::action::ActionRanges::default(),
    };
    // The PyTorch model beside it has this token.
    (ModelSpec { preset, action_token: ActionToken::Proprioception, ..ModelSpec::default() }, shape)
}

/// Episodes whose bytes do not repeat.
pub(crate) fn noise(shape: &TaskShape, count: u64) -> Vec<Trajectory> {
    let episode = |seed| {
        let (frames, m, a) = arrays(shape, seed);
        Trajectory::new(shape, format!("episode {seed}"), frames, m, a).unwrap()
    };
    (0..count).map(episode).collect()
}

/// The frames, proprioception and actions of one of them.
pub(crate) fn arrays(shape: &TaskShape, seed: u64) -> (Vec<u8>, Vec<f32>, Vec<f32>) {
    let mut state = seed * 2 + 1;
    let mut byte = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        state.to_be_bytes()[0]
    };
    let frames: Vec<u8> = std::iter::repeat_with(&mut byte).take(STEPS * shape.frame_bytes()).collect();
    let mut floats = |width: usize| (0..STEPS * width).map(|_| f32::from(byte()) / 128.0 - 1.0).collect();
    (frames, floats(shape.proprioception), floats(shape.action))
}

/// A policy with the size of a model, where it has one.
#[allow(dead_code, reason = "each bench is a crate of its own")]
pub(crate) fn policy(name: &str, model: ModelSpec) -> Chosen {
    let chosen = Chosen::new(Family::Policy, name).unwrap();
    match chosen.settings.contains_key("preset") {
        true => chosen.with(Family::Policy, "preset", model.preset.as_str()).unwrap(),
        false => chosen,
    }
}
