//! Names of what a robot measures, and what they mean.
//!
//! Pure functions on text.

use super::tokens::words;

/// Words that mark a measurement, whatever was measured.
const STATES: &[&str] = &[
    "state",
    "states",
    "obs",
    "observation",
    "observations",
    "measured",
    "measurement",
    "actual",
    "current",
    "feedback",
    "proprio",
    "proprioception",
    "sensed",
    "sensor",
    "sensors",
    "follower",
    "puppet",
];
const GRIPPERS: &[&str] =
    &["gripper", "grippers", "grip", "grasp", "finger", "fingers", "jaw", "jaws", "pinch", "claw", "pincers"];
const TOOLS: &[&str] = &["ee", "eef", "tcp", "tool", "effector", "endeffector", "flange", "wrist"];
const JOINTS: &[&str] = &["joint", "joints", "jnt", "motor", "motors", "q", "qpos", "jpos"];
const RATES: &[&str] = &["vel", "velocity", "velocities", "speed", "speeds", "twist"];
const JOINT_RATES: &[&str] = &["dq", "qd", "qdot", "qvel", "jvel"];
const TURNS: &[&str] = &["quat", "quaternion", "orientation", "rotation", "rot", "rpy", "euler", "axisangle"];
const PLACES: &[&str] = &["pos", "position", "xyz", "translation"];
const FORCES: &[&str] = &["force", "forces", "wrench", "ft"];
const TORQUES: &[&str] = &["tau", "torque", "torques", "effort", "efforts"];
const INERTIAL: &[&str] = &["imu", "accelerometer", "gyro", "gyroscope"];
const BASES: &[&str] = &["odom", "odometry", "base"];
/// Switches that a robot or a person sets off, and no policy.
const SWITCHES: &[&str] = &[
    "contact",
    "contacts",
    "touch",
    "bumper",
    "collision",
    "button",
    "buttons",
    "estop",
    "emergency",
    "fault",
    "error",
    "ready",
    "alive",
    "connected",
    "enabled",
    "status",
    "detected",
    "present",
    "limit",
    "done",
    "success",
    "closed",
    "opened",
    "grasped",
    "holding",
    "attached",
    "reached",
    "moving",
];
const SCENES: &[&str] = &["goal", "goals", "object", "objects", "obj", "cube", "block"];

/// Meanings that other rules of a draft refer to.
pub(super) const GRIPPER: &str = "the gripper";
pub(super) const JOINT_POSITIONS: &str = "joint positions";
pub(super) const JOINT_TORQUES: &str = "joint torques";
pub(super) const JOINT_VELOCITIES: &str = "joint velocities";

/// How certain it is that a path means a measurement rather than a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Measured {
    No,
    Perhaps,
    Yes,
}

/// Whether a path means a measurement.
pub(super) fn measured(path: &str) -> Measured {
    let words = stems(path);
    if has(&words, STATES) {
        return Measured::Yes;
    }
    // A gripper has a state and a command, often under the same name.
    let gripper = has(&words, GRIPPERS);
    if gripper || quantity(&words).is_none() { Measured::No } else { Measured::Perhaps }
}

/// Whether a switch of this name is measured.
pub(super) fn is_sensed(name: &str) -> bool {
    has(&stems(name), SWITCHES)
}

/// What the name of a field means, in words; `None` for one without a common name.
pub(super) fn meaning(name: &str) -> Option<&'static str> {
    let words = stems(name);
    if has(&words, GRIPPERS) {
        return Some(GRIPPER);
    }
    quantity(&words).or_else(|| has(&words, STATES).then_some("the state of the robot"))
}

/// Words without numbers at their end: robot0 is a robot, and q1 one of q.
fn stems(name: &str) -> Vec<String> {
    let stem = |word: String| word.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned();
    words(name).into_iter().map(stem).collect()
}

fn has(words: &[String], list: &[&str]) -> bool {
    words.iter().any(|word| list.contains(&word.as_str()))
}

fn quantity(words: &[String]) -> Option<&'static str> {
    let of = |list| has(words, list);
    let tool = of(TOOLS);
    let known = [
        (of(SCENES), "a goal or an object"),
        (tool && of(RATES), "the velocity of the end effector"),
        (tool && (of(FORCES) || of(TORQUES)), "forces at the end effector"),
        (tool && of(TURNS), "the orientation of the end effector"),
        (tool && of(PLACES), "the position of the end effector"),
        (tool, "the pose of the end effector"),
        (of(JOINT_RATES) || (of(JOINTS) && of(RATES)), JOINT_VELOCITIES),
        (of(TORQUES), JOINT_TORQUES),
        (of(JOINTS), JOINT_POSITIONS),
        (of(FORCES), "forces"),
        (of(INERTIAL), "an inertial sensor"),
        (of(BASES), "the base of the robot"),
    ];
    known.into_iter().find_map(|(is, meaning)| is.then_some(meaning))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn common_names_of_states_are_recognised() {
        for (name, expected) in [
            ("q", "joint positions"),
            ("robot.q", "joint positions"),
            ("robot_state_q", "joint positions"),
            ("qpos", "joint positions"),
            ("jointPositions", "joint positions"),
            ("robot0_joint_pos", "joint positions"),
            ("dq", "joint velocities"),
            ("robot0_joint_vel", "joint velocities"),
            ("tau_J", "joint torques"),
            ("robot0_eef_pos", "the position of the end effector"),
            ("robot0_eef_quat", "the orientation of the end effector"),
            ("ee_pose.position", "the position of the end effector"),
            ("ee_pose", "the pose of the end effector"),
            ("robot0_gripper_qpos", "the gripper"),
            ("ft_sensor.wrench", "forces"),
            ("observation.state", "the state of the robot"),
        ] {
            assert_eq!(meaning(name), Some(expected), "{name}");
        }
        assert_eq!(meaning("mode"), None);
    }

    #[test]
    fn a_measurement_is_certain_by_its_word_alone() {
        assert_eq!(["state.q", "robot.q", "gripper"].map(measured), [Measured::Yes, Measured::Perhaps, Measured::No]);
    }
}
