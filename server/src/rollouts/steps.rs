//! Builds an episode's steps from a session's events, in order.
//!
//! A step is an observation and the action executed after it. The action is known only at the next observation, and
//! whether an observation is sound only after the model, or else the writer, has decoded it. Steps wait here until both
//! are known. Pure: no clock, no file.

use std::collections::VecDeque;

use crate::domain::observation::Observation;

/// A complete step. `R` is its room in the queue.
#[derive(Debug)]
pub(super) struct Step<R> {
    pub(super) observation: Observation,
    /// The action executed from then on; `None` before the first.
    pub(super) action: Option<Vec<f32>>,
    /// Its images were decoded already.
    pub(super) sound: bool,
    pub(super) _room: R,
}

/// The incomplete steps of a running session.
#[derive(Debug)]
pub(super) struct Steps<R> {
    waiting: VecDeque<Waiting<R>>,
    /// The size of an action.
    action_size: usize,
    /// The action taken as executed until another is known.
    held: Option<Vec<f32>>,
    /// The stamp of the observation in the model.
    in_model: Option<i64>,
}

#[derive(Debug)]
struct Waiting<R> {
    step: Step<R>,
    /// Whether the executed action is known.
    done: bool,
    /// Whether it is known if the observation was decoded.
    judged: bool,
}

impl<R> Steps<R> {
    pub(super) fn new(action_size: usize) -> Self {
        Self { waiting: VecDeque::new(), action_size, held: None, in_model: None }
    }

    /// Adds an observation, which completes the action of the previous step. Without room it is left out.
    pub(super) fn observe(&mut self, observation: &Observation, room: Option<R>) {
        self.does(&observation.executed_action);
        if let Some(last) = self.waiting.back_mut().filter(|last| !last.done) {
            last.step.action.clone_from(&self.held);
            last.done = true;
        }
        for passed_over in self.waiting.iter_mut().filter(|one| Some(one.step.observation.stamp_ns) != self.in_model) {
            passed_over.judged = true;
        }
        if let Some(room) = room {
            let step = Step { observation: observation.clone(), action: None, sound: false, _room: room };
            self.waiting.push_back(Waiting { step, done: false, judged: false });
        }
    }

    /// The observation of this stamp was passed to the model.
    pub(super) fn inference_started(&mut self, stamp_ns: i64) {
        self.in_model = Some(stamp_ns);
    }

    /// The model returned; `sound`: the observation was decoded.
    pub(super) fn inference_finished(&mut self, sound: bool) {
        let in_model = self.in_model.take();
        if let Some(one) = self.waiting.iter_mut().find(|one| Some(one.step.observation.stamp_ns) == in_model) {
            (one.judged, one.step.sound) = (true, sound);
        }
    }

    /// Sets the action executed from now on. Actions of the wrong size or with non-finite values are ignored.
    pub(super) fn does(&mut self, action: &[f32]) {
        if action.len() == self.action_size && action.iter().all(|value| value.is_finite()) {
            self.held = Some(action.to_vec());
        }
    }

    /// Ends the session: every waiting step becomes complete.
    pub(super) fn end(&mut self) {
        if let Some(last) = self.waiting.back_mut().filter(|last| !last.done) {
            last.step.action = self.held.take();
            last.done = true;
        }
        self.waiting.iter_mut().for_each(|one| one.judged = true);
    }

    /// The oldest step, if it is complete.
    pub(super) fn next(&mut self) -> Option<Step<R>> {
        let whole = self.waiting.front().is_some_and(|one| one.done && one.judged);
        whole.then(|| self.waiting.pop_front()).flatten().map(|one| one.step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(stamp_ns: i64, executed_action: &[f32]) -> Observation {
        Observation {
            stamp_ns,
            cameras: Vec::new(),
            proprioception: Vec::new(),
            executed_action: executed_action.to_vec(),
            deadline: None,
            skipped_steps: 0,
        }
    }

    /// All complete steps: stamp, action, sound.
    fn out(steps: &mut Steps<()>) -> Vec<(i64, Option<f32>, bool)> {
        let one = |step: Step<()>| (step.observation.stamp_ns, step.action.map(|action| action[0]), step.sound);
        std::iter::from_fn(|| steps.next().map(one)).collect()
    }

    /// An observation that is answered before the next one.
    fn answered(steps: &mut Steps<()>, stamp_ns: i64, executed: &[f32], command: f32) {
        steps.observe(&seen(stamp_ns, executed), Some(()));
        steps.inference_started(stamp_ns);
        steps.inference_finished(true);
        steps.does(&[command]);
    }

    #[test]
    fn the_commanded_action_is_executed_unless_the_robot_sends_another() {
        let mut steps = Steps::new(1);
        answered(&mut steps, 1, &[], 10.0);
        assert!(out(&mut steps).is_empty(), "the newest step has no action yet");
        answered(&mut steps, 2, &[], 20.0);
        answered(&mut steps, 3, &[25.0], 30.0);
        assert_eq!(out(&mut steps), [(1, Some(10.0), true), (2, Some(25.0), true)]);
        steps.end();
        assert_eq!(out(&mut steps), [(3, Some(30.0), true)]);
    }

    #[test]
    fn without_a_command_the_last_action_is_held() {
        let mut steps = Steps::new(1);
        for stamp in 1..=2 {
            steps.observe(&seen(stamp, &[]), Some(()));
        }
        answered(&mut steps, 3, &[], 30.0);
        steps.observe(&seen(4, &[]), Some(()));
        steps.observe(&seen(5, &[50.0]), Some(()));
        steps.observe(&seen(6, &[]), Some(()));
        steps.end();
        let expected = [
            (1, None, false),
            (2, None, false),
            (3, Some(30.0), true),
            (4, Some(50.0), false),
            (5, Some(50.0), false),
            (6, Some(50.0), false),
        ];
        assert_eq!(out(&mut steps), expected);
    }

    #[test]
    fn observations_during_inference_wait_for_it() {
        let mut steps = Steps::new(1);
        steps.observe(&seen(1, &[]), Some(()));
        steps.inference_started(1);
        for stamp in 2..=4 {
            steps.observe(&seen(stamp, &[1.0]), Some(()));
        }
        assert!(out(&mut steps).is_empty());
        steps.inference_finished(true);
        assert_eq!(out(&mut steps), [(1, Some(1.0), true), (2, Some(1.0), false), (3, Some(1.0), false)]);
        steps.inference_started(4);
        steps.inference_finished(false);
        steps.end();
        assert_eq!(out(&mut steps), [(4, Some(1.0), false)], "an observation that was not decoded is not sound");
    }

    #[test]
    fn a_left_out_observation_still_completes_the_action_before_it() {
        let mut steps = Steps::new(1);
        answered(&mut steps, 1, &[], 10.0);
        steps.observe(&seen(2, &[15.0]), None);
        steps.inference_started(2);
        steps.inference_finished(true);
        steps.observe(&seen(3, &[25.0]), Some(()));
        steps.end();
        assert_eq!(out(&mut steps), [(1, Some(15.0), true), (3, Some(25.0), false)]);
    }

    #[test]
    fn invalid_actions_are_ignored() {
        let mut steps = Steps::new(1);
        answered(&mut steps, 1, &[], 10.0);
        answered(&mut steps, 2, &[f32::NAN], f32::INFINITY);
        answered(&mut steps, 3, &[1.0, 2.0], 30.0);
        steps.end();
        assert_eq!(out(&mut steps), [(1, Some(10.0), true), (2, Some(10.0), true), (3, Some(30.0), true)]);
    }
}
