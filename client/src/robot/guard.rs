//! The guard around a robot: it is stopped however the loop ends, by an error, a panic or a drop.

use gleaner_proto::v1::{Observation, Outcome};

use super::Robot;

/// Stops its robot on drop, unless the robot rests already.
pub(super) struct Guarded<'a, R: Robot> {
    robot: &'a mut R,
    resting: bool,
}

impl<'a, R: Robot> Guarded<'a, R> {
    /// A robot of unknown state counts as moving.
    pub(super) fn new(robot: &'a mut R) -> Self {
        Self { robot, resting: false }
    }

    /// Whether it was stopped and not commanded since.
    pub(super) fn resting(&self) -> bool {
        self.resting
    }

    pub(super) fn observe(&mut self) -> Result<Option<Observation>, R::Error> {
        self.robot.observe()
    }

    pub(super) fn outcome(&self) -> Outcome {
        self.robot.outcome()
    }

    pub(super) fn hold_action(&self, last: &[f32]) -> Vec<f32> {
        self.robot.hold_action(last)
    }

    pub(super) fn command(&mut self, action: &[f32]) -> Result<(), R::Error> {
        // Before the command: a command that fails may have moved the robot.
        self.resting = false;
        self.robot.command(action)
    }

    /// Stops the robot, unless it rests already.
    pub(super) fn stop(&mut self) -> Result<(), R::Error> {
        if !self.resting {
            self.robot.stop()?;
            self.resting = true;
        }
        Ok(())
    }
}

impl<R: Robot> Drop for Guarded<'_, R> {
    fn drop(&mut self) {
        // A drop cannot return the error; the loop itself stops the robot earlier and reports it.
        let _ = self.stop();
    }
}
