//! From what happens in a session, in the order in which it happens, to the steps of its episode.
//!
//! A step is what was observed and what was then done. What was done is known only when the next observation comes, and
//! whether an observation is sound only when the model, or else the writer, has looked at it. So steps wait here until
//! both are known, and leave in order. Pure: no clock, no file.

use std::collections::VecDeque;

use crate::domain::observation::Observation;

/// A step that is known whole. `R` is the room that it takes in the queue.
#[derive(Debug)]
pub(super) struct Step<R> {
    pub(super) observation: Observation,
    /// What was done from then on; `None` before anything was.
    pub(super) action: Option<Vec<f32>>,
    /// Its images were decoded already.
    pub(super) sound: bool,
    pub(super) _room: R,
}

/// The steps of a running session that are not known whole yet.
#[derive(Debug)]
pub(super) struct Steps<R> {
    waiting: VecDeque<Waiting<R>>,
    /// Numbers in an action.
    action_size: usize,
    /// What the robot is taken to do until something else is said.
    held: Option<Vec<f32>>,
    /// The stamp of the observation that the model has.
    asked: Option<i64>,
}

#[derive(Debug)]
struct Waiting<R> {
    step: Step<R>,
    /// What was done is known.
    done: bool,
    /// It is known whether anybody has decoded it.
    judged: bool,
}

impl<R> Steps<R> {
    pub(super) fn new(action_size: usize) -> Self {
        Self { waiting: VecDeque::new(), action_size, held: None, asked: None }
    }

    /// An observation has come; it ends the step before it. With no room for it, it is left out.
    pub(super) fn observe(&mut self, observation: &Observation, room: Option<R>) {
        self.does(&observation.executed_action);
        if let Some(last) = self.waiting.back_mut().filter(|last| !last.done) {
            last.step.action.clone_from(&self.held);
            last.done = true;
        }
        for passed_over in self.waiting.iter_mut().filter(|one| Some(one.step.observation.stamp_ns) != self.asked) {
            passed_over.judged = true;
        }
        if let Some(room) = room {
            let step = Step { observation: observation.clone(), action: None, sound: false, _room: room };
            self.waiting.push_back(Waiting { step, done: false, judged: false });
        }
    }

    /// The observation of this stamp goes to the model.
    pub(super) fn asks(&mut self, stamp_ns: i64) {
        self.asked = Some(stamp_ns);
    }

    /// What the model had is back; `sound` says that it was decoded.
    pub(super) fn turned(&mut self, sound: bool) {
        let asked = self.asked.take();
        if let Some(one) = self.waiting.iter_mut().find(|one| Some(one.step.observation.stamp_ns) == asked) {
            (one.judged, one.step.sound) = (true, sound);
        }
    }

    /// The robot does this from now on. What makes no sense says nothing.
    pub(super) fn does(&mut self, action: &[f32]) {
        if action.len() == self.action_size && action.iter().all(|value| value.is_finite()) {
            self.held = Some(action.to_vec());
        }
    }

    /// Nothing more comes.
    pub(super) fn end(&mut self) {
        if let Some(last) = self.waiting.back_mut().filter(|last| !last.done) {
            last.step.action = self.held.take();
            last.done = true;
        }
        self.waiting.iter_mut().for_each(|one| one.judged = true);
    }

    /// The oldest step, if it is known whole.
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
        }
    }

    /// Everything that is known whole: stamp, action, sound.
    fn out(steps: &mut Steps<()>) -> Vec<(i64, Option<f32>, bool)> {
        let one = |step: Step<()>| (step.observation.stamp_ns, step.action.map(|action| action[0]), step.sound);
        std::iter::from_fn(|| steps.next().map(one)).collect()
    }

    /// An observation that the model answers before the next one comes.
    fn answered(steps: &mut Steps<()>, stamp_ns: i64, executed: &[f32], command: f32) {
        steps.observe(&seen(stamp_ns, executed), Some(()));
        steps.asks(stamp_ns);
        steps.turned(true);
        steps.does(&[command]);
    }

    #[test]
    fn what_was_commanded_was_done_unless_the_robot_says_otherwise() {
        let mut steps = Steps::new(1);
        answered(&mut steps, 1, &[], 10.0);
        assert!(out(&mut steps).is_empty(), "what is done at the newest is not known yet");
        answered(&mut steps, 2, &[], 20.0);
        answered(&mut steps, 3, &[25.0], 30.0);
        assert_eq!(out(&mut steps), [(1, Some(10.0), true), (2, Some(25.0), true)]);
        steps.end();
        assert_eq!(out(&mut steps), [(3, Some(30.0), true)]);
    }

    #[test]
    fn without_a_command_the_last_action_is_held_and_before_the_first_there_is_none() {
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
    fn those_that_came_while_the_model_was_busy_wait_for_it() {
        let mut steps = Steps::new(1);
        steps.observe(&seen(1, &[]), Some(()));
        steps.asks(1);
        for stamp in 2..=4 {
            steps.observe(&seen(stamp, &[1.0]), Some(()));
        }
        assert!(out(&mut steps).is_empty());
        steps.turned(true);
        assert_eq!(out(&mut steps), [(1, Some(1.0), true), (2, Some(1.0), false), (3, Some(1.0), false)]);
        steps.asks(4);
        steps.turned(false);
        steps.end();
        assert_eq!(out(&mut steps), [(4, Some(1.0), false)], "one that was not decoded in time is not sound");
    }

    #[test]
    fn what_is_left_out_takes_its_action_along() {
        let mut steps = Steps::new(1);
        answered(&mut steps, 1, &[], 10.0);
        steps.observe(&seen(2, &[15.0]), None);
        steps.asks(2);
        steps.turned(true);
        steps.observe(&seen(3, &[25.0]), Some(()));
        steps.end();
        assert_eq!(out(&mut steps), [(1, Some(15.0), true), (3, Some(25.0), false)]);
    }

    #[test]
    fn actions_that_make_no_sense_say_nothing() {
        let mut steps = Steps::new(1);
        answered(&mut steps, 1, &[], 10.0);
        answered(&mut steps, 2, &[f32::NAN], f32::INFINITY);
        answered(&mut steps, 3, &[1.0, 2.0], 30.0);
        steps.end();
        assert_eq!(out(&mut steps), [(1, Some(10.0), true), (2, Some(10.0), true), (3, Some(30.0), true)]);
    }
}
