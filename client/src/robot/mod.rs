//! The robot interface and the loop that controls a robot with a deployed policy at a fixed rate.
//!
//! [`Client::control`](crate::Client::control) runs the loop. At each tick of the control period it observes, sends the
//! observation without waiting, takes available answers, and commands the due action. When an action is late or the
//! server is lost, the robot holds for a while, then stops, and resumes with the next action. Must not know how a
//! policy decides.

mod buffer;
mod control;
mod guard;
mod latest;
mod link;
mod plan;
mod report;
mod session_task;
mod sim;
mod ticks;

use gleaner_proto::v1::{Observation, Outcome};

pub use buffer::{ActionBuffer, Ensembling};
pub use control::control;
pub use link::{Link, SessionChannel};
pub use plan::ControlPlan;
pub use report::{ControlCause, ControlError, ControlReport};
pub use sim::SimRobot;

/// A robot or a double of one. Its methods must return at once: they share the loop's period and run on a thread that
/// the runtime needs. A robot that must wait for its hardware does so in its own task or thread and returns the newest
/// data here. The methods are synchronous so that they also run when the loop is dropped: the robot is stopped then,
/// too.
pub trait Robot {
    /// The robot's errors. Any error stops the robot and ends the loop.
    type Error: std::error::Error + 'static;

    /// Returns the robot's observation; `None` ends the run.
    ///
    /// `stamp_ns` is the robot's own clock and must rise from one observation to the next; with 0 the loop sets the
    /// time of its tick. `executed_action` is the action really executed since the previous observation; when empty,
    /// the loop sets the last command. `deadline_us` 0 is the plan's.
    ///
    /// # Errors
    /// The robot's own.
    fn observe(&mut self) -> Result<Option<Observation>, Self::Error>;

    /// Executes an action, in the units of the task's action, for one control period.
    ///
    /// # Errors
    /// The robot's own; also for an action that does not fit the robot.
    fn command(&mut self, action: &[f32]) -> Result<(), Self::Error>;

    /// Brings the robot to rest safely. Called at the end of every run, however it ends, and during a run when no
    /// action came for too long; a later command moves the robot again.
    ///
    /// # Errors
    /// The robot's own.
    fn stop(&mut self) -> Result<(), Self::Error>;

    /// The outcome of the attempt at the end of the run: the label of the recorded episode. Unknown by default.
    fn outcome(&self) -> Outcome {
        Outcome::Unknown
    }

    /// The action that keeps the robot in place while it waits for the policy, given the last command. By default that
    /// command again; a robot whose actions are displacements must override this, or it keeps moving.
    fn hold_action(&self, last: &[f32]) -> Vec<f32> {
        last.to_vec()
    }
}

#[cfg(test)]
mod tests;
