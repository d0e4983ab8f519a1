//! Words in the names of topics and fields, and what they suggest.
//!
//! Pure functions on text.

use std::collections::BTreeSet;

/// Words of commands: certain ones, and ones that count only where no topic has a certain one.
const COMMANDS: &[&str] =
    &["action", "actions", "command", "commands", "commanded", "cmd", "cmds", "ctrl", "setpoint", "teleop"];
const PERHAPS_COMMANDS: &[&str] =
    &["target", "targets", "desired", "control", "controls", "servo", "leader", "reference"];
/// Words of whole steps.
const STEPS: &[&str] =
    &["step", "steps", "transition", "transitions", "frame", "frames", "sample", "samples", "record", "rollout"];
/// Words of what a policy must not see.
const OUTCOMES: &[&str] =
    &["reward", "rewards", "success", "done", "terminated", "truncated", "outcome", "label", "return", "score"];
/// Words of counters and clocks.
const COUNTERS: &[&str] =
    &["index", "idx", "seq", "sequence", "count", "counter", "id", "time", "timestamp", "stamp", "step", "episode"];
/// Parts of times and headers of messages.
const TIMES: &[&str] = &["header", "timestamp", "stamp"];
/// Message types with the poses of frames in each other.
const TRANSFORMS: &[&str] = &["TFMessage", "FrameTransform", "FrameTransforms"];
/// Message types that describe the scene or the recorder rather than the robot.
const FOREIGN: &[&str] = &[
    "CameraInfo",
    "CameraCalibration",
    "DiagnosticArray",
    "Log",
    "ParameterEvent",
    "PointCloud",
    "PointCloud2",
    "LaserScan",
    "OccupancyGrid",
    "Marker",
    "MarkerArray",
    "SceneUpdate",
    "Clock",
    "ImageAnnotations",
    "RobotDescription",
];
/// Names of containers, which say less than the topic.
const CONTAINERS: &[&str] = &[
    "data",
    "value",
    "values",
    "vector",
    "pose",
    "point",
    "twist",
    "position",
    "positions",
    "array",
    "numbers",
    "wrench",
    "transform",
    "msg",
    "message",
];
/// Names of quantities, which say what was measured and not where.
const QUANTITIES: &[&str] =
    &["orientation", "rotation", "quat", "angle", "angles", "pos", "vel", "velocity", "force", "torque", "width"];
/// Words of a topic that do not distinguish cameras.
const OF_CAMERAS: &[&str] = &[
    "camera",
    "cameras",
    "cam",
    "color",
    "colour",
    "rgb",
    "image",
    "images",
    "img",
    "raw",
    "compressed",
    "depth",
    "video",
    "rect",
    "aligned",
    "to",
    "sensor",
    "sensors",
    "stream",
    "observation",
    "observations",
    "obs",
    "compresseddepth",
    "mono",
];

/// How certain it is that a name means a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Command {
    No,
    Perhaps,
    Yes,
}

/// The words of a name: parts between punctuation, and between lower and upper case.
pub(super) fn words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = vec![String::new()];
    let mut before = ' ';
    for c in name.chars() {
        if !c.is_alphanumeric() || (c.is_uppercase() && before.is_lowercase()) {
            words.push(String::new());
        }
        if let (true, Some(word)) = (c.is_alphanumeric(), words.last_mut()) {
            word.extend(c.to_lowercase());
        }
        before = c;
    }
    words.retain(|word| !word.is_empty());
    words
}

fn has(name: &str, list: &[&str]) -> bool {
    words(name).iter().any(|word| list.contains(&word.as_str()))
}

/// Whether a topic or a path means a command.
pub(super) fn command_word(name: &str) -> Command {
    let lists = [(COMMANDS, Command::Yes), (PERHAPS_COMMANDS, Command::Perhaps)];
    lists.into_iter().find_map(|(list, found)| has(name, list).then_some(found)).unwrap_or(Command::No)
}

/// Whether a name is that of a goal, which can be a command or a part of the scene.
pub(super) fn is_goal(name: &str) -> bool {
    has(name, &["goal", "goals"])
}

/// Whether a topic is named like whole steps, which have commands and measurements in one message.
pub(super) fn is_container(topic: &str) -> bool {
    has(topic, STEPS)
}

/// Whether a single number is an outcome of the attempt.
pub(super) fn is_outcome(topic: &str, path: &str) -> bool {
    has(path, OUTCOMES) || has(topic, OUTCOMES)
}

/// Whether a single number counts or is a time.
pub(super) fn is_counter(path: &str) -> bool {
    words(path).last().is_some_and(|word| COUNTERS.contains(&word.as_str()))
}

/// Whether a path belongs to the time of the message, to a covariance, or to the description of an array (the `layout` of
/// ROS's arrays).
pub(super) fn is_aside(path: &str) -> bool {
    let first = path.split('.').next().unwrap_or_default();
    TIMES.contains(&first) || path.starts_with("layout.") || has(path, &["covariance"])
}

/// Whether messages of this schema describe something beside the robot.
pub(super) fn is_foreign(schema: &str) -> bool {
    FOREIGN.contains(&kind(schema))
}

/// Whether messages of this schema have the poses of frames in each other.
pub(super) fn has_transforms(schema: &str) -> bool {
    TRANSFORMS.contains(&kind(schema))
}

/// A schema without its package.
fn kind(schema: &str) -> &str {
    schema.rsplit(['/', '.']).next().unwrap_or_default()
}

/// The name of a camera: the words of its topic that are not common to cameras.
pub(super) fn camera_name(topic: &str) -> String {
    let own: Vec<String> = words(topic).into_iter().filter(|word| !OF_CAMERAS.contains(&word.as_str())).collect();
    if own.is_empty() { "camera".to_owned() } else { own.join("_") }
}

/// The name of a field: the end of its path, or of its topic where the path says little.
pub(super) fn field_name(topic: &str, path: &str) -> String {
    let mut ends = path.rsplit('.');
    let own = ends.next().unwrap_or_default();
    let container = own.is_empty() || CONTAINERS.contains(&own);
    // Of `ee_pose.position` the part before says what has the position.
    if (container || QUANTITIES.contains(&own))
        && let Some(before) = ends.next().filter(|before| !CONTAINERS.contains(before))
    {
        return identifier(&format!("{before}_{own}"));
    }
    if !container {
        return identifier(own);
    }
    let parts: Vec<&str> = topic.split('/').filter(|part| !part.is_empty()).collect();
    let last = parts.last().copied().unwrap_or_default();
    let alone = has(last, COMMANDS) || ["state", "states", "data", "value"].contains(&last);
    let name = match parts.len().checked_sub(2).and_then(|at| parts.get(at)) {
        Some(before) if alone && words(last).len() == 1 => format!("{before}_{last}"),
        _ => last.to_owned(),
    };
    identifier(&name)
}

/// A name as tasks take it: a letter, then letters, digits and `_`.
pub(super) fn identifier(name: &str) -> String {
    let plain = words(name).join("_");
    let plain: String = plain.chars().filter(|c| c.is_ascii_alphanumeric() || *c == '_').take(100).collect();
    let begins = plain.starts_with(|c: char| c.is_ascii_alphabetic());
    match plain.as_str() {
        "" | "timestamp" => format!("field_{plain}").trim_end_matches('_').to_owned(),
        _ if begins => plain,
        _ => format!("field_{plain}"),
    }
}

/// The share of words that two names have in common, from 0 to 1.
#[expect(clippy::cast_precision_loss, reason = "names have few words")]
pub(super) fn likeness(one: &str, other: &str) -> f64 {
    let set = |name: &str| -> BTreeSet<String> {
        words(name).into_iter().map(|word| word.trim_end_matches('s').to_owned()).collect()
    };
    let (one, other) = (set(one), set(other));
    let all = one.union(&other).count();
    if all == 0 { 0.0 } else { one.intersection(&other).count() as f64 / all as f64 }
}

/// Names in the order of people: numbers by their value, and larger groups of one stem first.
pub(super) fn natural(names: &[String]) -> Vec<String> {
    let stem = |name: &str| name.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned();
    let count = |name: &str| names.iter().filter(|other| stem(other) == stem(name)).count();
    let mut sorted = names.to_vec();
    sorted.sort_by_cached_key(|name| {
        let number = name.get(stem(name).len()..).and_then(|digits| digits.parse::<u64>().ok());
        (std::cmp::Reverse(count(name)), stem(name), number, name.clone())
    });
    sorted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_words_and_suggest_a_role() {
        assert_eq!(words("/handCamera/color_raw2"), ["hand", "camera", "color", "raw2"]);
        assert_eq!(command_word("/servo/delta_twist_cmds"), Command::Yes);
        assert_eq!(command_word("/leader/joint_states"), Command::Perhaps);
        assert_eq!(command_word("/joint_states"), Command::No);
        assert!(is_outcome("/episode", "next.success") && !is_outcome("/goal", "point"));
        assert!(is_counter("frame_index") && !is_counter("index_finger"));
        assert!(is_foreign("sensor_msgs/msg/CameraInfo") && !is_foreign("sensor_msgs/msg/JointState"));
        assert!(has_transforms("tf2_msgs/msg/TFMessage") && has_transforms("foxglove.FrameTransform"));
        assert!(is_aside("header.stamp.sec") && is_aside("pose.covariance") && !is_aside("pose.position.x"));
        assert!(is_aside("layout.data_offset") && !is_aside("data"));
    }

    #[test]
    fn cameras_and_fields_are_named_by_what_distinguishes_them() {
        assert_eq!(camera_name("/camera/hand/color"), "hand");
        assert_eq!(camera_name("/hand_camera/color/image_raw/compressed"), "hand");
        assert_eq!(camera_name("/camera/color/image_raw"), "camera");
        assert_eq!(field_name("/robot/state", "joint_position"), "joint_position");
        assert_eq!(field_name("/tool_pose", "pose"), "tool_pose");
        assert_eq!(field_name("/gripper/command", "data"), "gripper_command");
        assert_eq!(field_name("/step", "observation.state"), "state");
        assert_eq!(field_name("/robot", "ee_pose.position"), "ee_pose_position");
        assert_eq!(field_name("/robot", "gripper.width"), "gripper_width");
        assert_eq!(field_name("/imu", "orientation"), "orientation");
        assert_eq!(field_name("/x", "7dof-arm"), "field_7dof_arm");
    }

    #[test]
    fn joints_come_in_the_order_of_people() {
        let names = ["finger2", "arm10", "arm2", "finger1", "arm1"].map(str::to_owned);
        assert_eq!(natural(&names), ["arm1", "arm2", "arm10", "finger1", "finger2"]);
    }

    #[test]
    fn likeness_is_a_share_of_words() {
        assert!((likeness("goal", "goal_position") - 0.5).abs() < 1e-9);
        assert!(likeness("gripper", "delta_pose") < 1e-9);
    }
}
