//! The embedded simulator as a robot. Each command advances its time; between commands the world stands still.

use gleaner_proto::v1::{Observation, Outcome};
use gleaner_recording::TaskSpec;
use gleaner_sim::{ACTION_SIZE, Sim, SimConfig, Task};

use super::Robot;
use crate::error::{ClientError, Result};
use crate::session::observation;

/// A simulated attempt at a task. The run ends when the attempt is done.
#[derive(Clone, Debug)]
pub struct SimRobot {
    sim: Sim,
    spec: TaskSpec,
}

impl SimRobot {
    /// Starts an attempt, determined by its seed.
    #[must_use]
    pub fn new(task: Task, config: SimConfig, seed: u64) -> Self {
        Self { sim: Sim::new(task, config, seed), spec: gleaner_sim::task_spec(task, &config) }
    }

    /// The attempt so far.
    #[must_use]
    pub fn sim(&self) -> &Sim {
        &self.sim
    }
}

impl Robot for SimRobot {
    type Error = ClientError;

    fn observe(&mut self) -> Result<Option<Observation>> {
        if self.sim.done() {
            return Ok(None);
        }
        let seen = self.sim.observe();
        // Stamped by the loop: the simulator's own clock stands still while the robot rests.
        observation(&self.spec, 0, seen.frames, seen.proprioception).map(Some)
    }

    fn command(&mut self, action: &[f32]) -> Result<()> {
        let action = action.try_into().map_err(|_| {
            ClientError::Invalid(format!(
                "the policy gives {} action values, the simulator takes {ACTION_SIZE}; was the policy trained on this task?",
                action.len()
            ))
        })?;
        self.sim.step(action);
        Ok(())
    }

    fn stop(&mut self) -> Result<()> {
        Ok(())
    }

    /// The simulator's verdict, once the attempt is done.
    fn outcome(&self) -> Outcome {
        match (self.sim.done(), self.sim.success()) {
            (false, _) => Outcome::Unknown,
            (true, true) => Outcome::Success,
            (true, false) => Outcome::Failure,
        }
    }

    /// Zero displacement with the gripper unchanged: all values but the gripper's are displacements.
    fn hold_action(&self, last: &[f32]) -> Vec<f32> {
        let gripper = ACTION_SIZE - 1;
        last.iter().enumerate().map(|(place, &value)| if place == gripper { value } else { 0.0 }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_drive_the_attempt_which_ends_the_run() {
        let config = SimConfig { max_steps: 2, ..SimConfig::default() };
        let mut robot = SimRobot::new(Task::PickCube, config, 3);
        assert!(robot.observe().unwrap().is_some());
        let action = [0.5, 0.5, 0.5, 0.0, 0.0, 0.1, -1.0];
        robot.command(&action).unwrap();
        robot.stop().unwrap();
        assert_eq!((robot.sim().steps(), robot.outcome()), (1, Outcome::Unknown));
        let hold = robot.hold_action(&action);
        assert_eq!(hold, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
        robot.command(&hold).unwrap();
        assert!(robot.observe().unwrap().is_none());
        assert_eq!(robot.outcome(), Outcome::Failure);
        assert!(robot.command(&[1.0]).unwrap_err().to_string().contains("1 action values"));
    }
}
