//! Tests of the order of values where recordings come in several ways.

use super::*;

const QUATERNION: [(&str, f64); 4] = [("w", 0.9), ("x", -0.1), ("y", 0.1), ("z", 0.4)];

fn command(topic_of: &str, encoding: &str) -> SurveyedTopic {
    topic(topic_of, encoding, vec![numbers("delta", &[range(-0.95, 0.3), range(-0.2, 0.99)])])
}

/// A way whose rotation has names, as messages of ROS 2 write them: w last.
fn by_name(prefix: &str) -> Survey {
    let [w, x, y, z] = QUATERNION;
    let parts = [x, y, z, w].map(|(part, low)| numbers(&format!("pose.orientation.{part}"), &[range(low, low + 0.05)]));
    let pose = topic(&format!("/{prefix}/tool_pose"), "cdr", parts.into());
    recording(vec![pose, command(&format!("/{prefix}/command"), "cdr")])
}

#[test]
fn the_way_with_a_fixed_order_decides_for_all_others() {
    let values = QUATERNION.map(|(_, low)| range(low, low + 0.05));
    let array =
        recording(vec![topic("/state", "json", vec![numbers("tool_pose", &values)]), command("/arm/command", "json")]);
    let (left, right) = (by_name("left"), by_name("right"));
    // The way with a choice of orders comes first, the next one has the same choice, the last has none.
    let surveys = [&left, &left, &left, &right, &right, &array];
    let spec = written(&draft(surveys, &known("pick")).unwrap());
    let of_mapping = |mapping: &Mapping| {
        let source = mapping.fields.iter().find(|source| source.field == "tool_pose").unwrap();
        source.paths.iter().map(|path| path.rsplit('.').next().unwrap().to_owned()).collect::<Vec<_>>()
    };
    let found: Vec<_> = spec.mappings.iter().map(of_mapping).collect();
    assert_eq!(found, [vec!["w", "x", "y", "z"], vec!["w", "x", "y", "z"], vec!["tool_pose"]]);
}
