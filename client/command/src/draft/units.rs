//! The units of numbers in standard messages of ROS 2, by its conventions (REP 103). Must not know how fields are found.

/// A part of a path, and its unit.
type Unit = (&'static str, &'static str);

/// What a message's numbers are measured in, by the last part of the schema's name.
const UNITS: &[(&[&str], &[Unit])] = &[
    (
        &["JointState", "JointTrajectory", "JointTrajectoryPoint"],
        &[
            ("position", "rad or m"),
            ("positions", "rad or m"),
            ("velocity", "rad/s or m/s"),
            ("velocities", "rad/s or m/s"),
            ("accelerations", "rad/s² or m/s²"),
            ("effort", "N m or N"),
        ],
    ),
    (&["Twist", "TwistStamped", "TwistWithCovarianceStamped"], &[("linear", "m/s"), ("angular", "rad/s")]),
    (&["Accel", "AccelStamped"], &[("linear", "m/s²"), ("angular", "rad/s²")]),
    (&["Wrench", "WrenchStamped"], &[("force", "N"), ("torque", "N m")]),
    (
        &["Pose", "PoseStamped", "PoseWithCovarianceStamped", "Odometry", "TransformStamped"],
        &[
            ("position", "m"),
            ("translation", "m"),
            ("orientation", "no unit (a quaternion)"),
            ("rotation", "no unit (a quaternion)"),
            ("linear", "m/s"),
            ("angular", "rad/s"),
        ],
    ),
    (
        &["Imu"],
        &[("angular_velocity", "rad/s"), ("linear_acceleration", "m/s²"), ("orientation", "no unit (a quaternion)")],
    ),
];
/// The packages whose messages have these units.
const PACKAGES: &[&str] = &["sensor_msgs", "geometry_msgs", "nav_msgs", "trajectory_msgs"];

/// What the numbers at these paths are measured in; `None` for other messages.
pub(super) fn of_paths(schema: &str, paths: &[String]) -> Option<String> {
    let mut units: Vec<&str> = paths.iter().map(|path| unit(schema, path)).collect::<Option<_>>()?;
    units.dedup();
    (!units.is_empty()).then(|| units.join(", then "))
}

fn unit(schema: &str, path: &str) -> Option<&'static str> {
    let mut parts = schema.split('/');
    let (package, name) = (parts.next()?, parts.next_back()?);
    if !PACKAGES.contains(&package) {
        return None;
    }
    let (_, units) = UNITS.iter().find(|(names, _)| names.contains(&name))?;
    let of = |part: &str| units.iter().find(|(known, _)| *known == part).map(|(_, unit)| *unit);
    // The innermost part: `twist.twist.linear.x` is a velocity.
    path.split(['.', '[']).rev().find_map(of)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(schema: &str, paths: &[&str]) -> Option<String> {
        of_paths(schema, &paths.iter().map(|path| (*path).to_owned()).collect::<Vec<_>>())
    }

    #[test]
    fn units_are_those_of_the_conventions() {
        for (schema, path, unit) in [
            ("sensor_msgs/msg/JointState", "position", "rad or m"),
            ("sensor_msgs/JointState", "effort", "N m or N"),
            ("trajectory_msgs/msg/JointTrajectory", "points[0].velocities", "rad/s or m/s"),
            ("geometry_msgs/msg/TwistStamped", "twist.angular.z", "rad/s"),
            ("nav_msgs/msg/Odometry", "twist.twist.linear.x", "m/s"),
            ("sensor_msgs/msg/Imu", "linear_acceleration.y", "m/s²"),
        ] {
            assert_eq!(of(schema, &[path]).as_deref(), Some(unit), "{schema}");
        }
    }

    #[test]
    fn a_pose_has_two_units_and_other_messages_have_none() {
        let pose = ["pose.position.x", "pose.position.y", "pose.orientation.z", "pose.orientation.w"];
        let found = of("geometry_msgs/msg/PoseStamped", &pose).unwrap();
        assert_eq!(found, "m, then no unit (a quaternion)");
        for (schema, path) in [
            ("std_msgs/msg/Float64MultiArray", "data"),
            ("my_robot/msg/JointState", "position"),
            ("sensor_msgs/msg/JointState", "header.stamp.sec"),
            ("gleaner.v1.Numbers", "joints"),
            ("", "position"),
        ] {
            assert_eq!(of(schema, &[path]), None, "{schema} {path}");
        }
    }
}
