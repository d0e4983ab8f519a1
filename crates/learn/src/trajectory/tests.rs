//! The checks of an episode, its content, and steps that cannot be read.

use super::*;
use crate::shape::CameraShape;
use crate::toy;

fn shape() -> TaskShape {
    TaskShape {
        cameras: vec![CameraShape { name: "top".into(), height: 8, width: 8, depth: true, recorded: None }],
        proprioception: 2,
        action: 1,
        ranges: gleaner_core::action::ActionRanges::default(),
    }
}

fn build(frames: usize, proprioception: Vec<f32>, action: Vec<f32>) -> Result<Trajectory, LearnError> {
    Trajectory::new(&shape(), "ep", vec![0; frames], proprioception, action)
}

#[test]
fn lengths_must_agree_on_the_number_of_steps() {
    assert_eq!(build(640, vec![0.0; 4], vec![0.0; 2]).unwrap().steps(), 2);
    for (bad, field) in [
        (build(639, vec![0.0; 4], vec![0.0; 2]), "frames"),
        (build(640, vec![0.0; 3], vec![0.0; 2]), "proprioception"),
        (build(0, vec![], vec![]), "action"),
    ] {
        let message = bad.unwrap_err().to_string();
        assert!(message.starts_with(&format!("episode ep: {field}")), "{message}");
    }
    let other = build(640, vec![0.0; 4], vec![0.0; 2]).unwrap().validate(&toy::shape()).unwrap_err().to_string();
    assert!(other.contains("episode ep: action: has 1 a step"), "{other}");
}

#[test]
fn a_value_that_is_not_finite_is_placed() {
    let error = build(640, vec![0.0, 0.0, 0.0, f32::NAN], vec![0.0; 2]).unwrap_err();
    assert!(error.to_string().contains("dimension 1 of step 1"), "{error}");
}

#[test]
fn content_follows_each_value_and_not_the_id() {
    let episode = toy::episode("e", 1, 2 * HASHED_STEPS + 1, true);
    let content = |of: &Trajectory| of.content().unwrap();
    assert_eq!(content(&episode), content(&Trajectory { id: "other".into(), ..episode.clone() }));
    assert_eq!(content(&episode), content(&episode.with_actions(episode.actions().unwrap())));
    for changed in [
        episode.changed(|arrays| *arrays.frames.last_mut().unwrap() ^= 1),
        episode.changed(|arrays| arrays.proprioception[0] += 1.0),
        episode.with_actions(episode.actions().unwrap().iter().map(|value| value + 1.0).collect()),
    ] {
        assert_ne!(content(&episode), content(&changed));
    }
}

/// A source on a disk that fails.
struct Broken;

impl StepSource for Broken {
    fn steps(&self) -> usize {
        4
    }

    fn widths(&self) -> StepWidths {
        StepWidths::from(&toy::shape())
    }

    fn numbers(&self, _: Range<usize>) -> Result<Numbers, SourceError> {
        Err("the disk is gone".into())
    }

    fn frames(&self, _: Range<usize>, _: &mut [u8]) -> Result<(), SourceError> {
        Err("the disk is gone".into())
    }
}

#[test]
fn steps_that_cannot_be_read_fail_each_stage_with_their_episode() {
    let broken = Trajectory::read_from(&toy::shape(), "gone", Arc::new(Broken)).unwrap();
    let data = [toy::episode("e", 1, 6, true), broken];
    let mut silent = crate::train::Silent;
    let error = crate::pretrain(&toy::shape(), &data, &toy::pretrain_spec(1), None, None, &mut silent).unwrap_err();
    assert_eq!(error.to_string(), "episode gone cannot be read: the disk is gone");
}
