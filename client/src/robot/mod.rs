//! Robots: what one must be able to do, and the loop that lets a deployed policy control it at a fixed rate.
//!
//! [`Client::control`](crate::Client::control) runs the loop. At each tick of the control period it observes, hands the
//! observation over without waiting, takes what answers there are, and commands the action that is due. An action
//! that is late, or a server that is lost, means the same to the robot: it holds for a while, then stops, and goes on
//! when actions come again. Knows nothing of how a policy decides.

mod buffer;
mod control;
mod courier;
mod guard;
mod link;
mod plan;
mod report;
mod sim;
mod slot;
mod ticks;

use gleaner_proto::v1::{Observation, Outcome};

pub use buffer::{ActionBuffer, Ensembling};
pub use control::control;
pub use link::{Line, Link};
pub use plan::ControlPlan;
pub use report::{ControlCause, ControlError, ControlReport};
pub use sim::SimRobot;

/// A robot, or what stands for one. Its methods return at once: the loop's own period is what they may use of it, and
/// they run on a thread that the runtime needs. One that must wait for its hardware does so in a task or thread of
/// its own and answers here with the newest there is. Being plain functions they also run when the loop is dropped:
/// the robot is stopped then, too.
pub trait Robot {
    /// What can go wrong with it. Any error stops the robot and ends the loop.
    type Error: std::error::Error + 'static;

    /// What the robot sees and feels now; `None` ends the run.
    ///
    /// `stamp_ns` is the robot's own clock and must rise from one observation to the next; 0 has the loop stamp it
    /// with the time of its tick. `executed_action` says what was really executed since the observation before; empty
    /// has the loop say what it commanded. `deadline_us` 0 is the plan's.
    ///
    /// # Errors
    /// The robot's own.
    fn observe(&mut self) -> Result<Option<Observation>, Self::Error>;

    /// Executes an action, in the units of the task's action, for one control period.
    ///
    /// # Errors
    /// The robot's own; also for an action that does not fit it.
    fn command(&mut self, action: &[f32]) -> Result<(), Self::Error>;

    /// Comes to rest safely. Called at the end of every run, however it ends, and in the middle when no action came
    /// for too long; a command after that moves the robot again.
    ///
    /// # Errors
    /// The robot's own.
    fn stop(&mut self) -> Result<(), Self::Error>;

    /// How the attempt has gone, asked when the run is over: the label of the recorded episode. Unknown, unless the
    /// robot knows.
    fn outcome(&self) -> Outcome {
        Outcome::Unknown
    }

    /// The action that holds the robot where it is while it waits for the policy, given what was commanded last. That
    /// action again, unless the robot says otherwise: one whose actions are displacements must, or it moves on.
    fn hold_action(&self, last: &[f32]) -> Vec<f32> {
        last.to_vec()
    }
}

#[cfg(test)]
mod tests;
