//! The guard around a robot: whatever becomes of the loop (an error, a panic, being dropped), the robot is stopped.

use gleaner_proto::v1::{Observation, Outcome};

use super::Robot;

/// A robot that is stopped when this goes away, unless it rests already.
pub(super) struct Guarded<'a, R: Robot> {
    robot: &'a mut R,
    resting: bool,
}

impl<'a, R: Robot> Guarded<'a, R> {
    /// Of a robot nothing is known yet: it counts as moving.
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
        // First: a command that fails may have moved it.
        self.resting = false;
        self.robot.command(action)
    }

    /// Stops it, if it does not rest already.
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
        // Whoever drops us takes no error any more; the loop itself stops the robot before and says so.
        let _ = self.stop();
    }
}
