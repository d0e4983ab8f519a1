//! Values of an action that never move, and the limits of those that do.

use super::*;

/// A twist of which two values move, as the operator of a planar robot sends it.
#[test]
fn values_of_an_action_that_are_always_0_are_left_out() {
    let moves = |part: &str| if part == "linear.x" { range(-0.25, 0.5) } else { range(-0.1, 0.1) };
    let still = |part: &str| if ["linear.x", "linear.z"].contains(&part) { moves(part) } else { range(0.0, 0.0) };
    let of = |range: &dyn Fn(&str) -> ValueRange| {
        let parts = ["linear.x", "linear.y", "linear.z", "angular.x", "angular.y", "angular.z"];
        let twist = parts.map(|part| numbers(&format!("twist.{part}"), &[range(part)]));
        let twist =
            SurveyedTopic { schema: "geometry_msgs/msg/TwistStamped".into(), ..topic("/cmd_vel", "cdr", twist.into()) };
        draft([&recording(vec![camera("/front", "cdr", (96, 96)), twist])], &known("t")).unwrap()
    };
    let draft = of(&still);
    let spec = written(&draft);
    assert_eq!(spec.mappings[0].fields[0].paths, ["twist.linear.x", "twist.linear.z"]);
    assert_eq!((spec.action[0].size, spec.action[0].unit.as_str()), (2, "m/s"));
    let text = draft.to_string();
    for part in [
        "twist.angular.z are always 0",
        "\nminimum = [-0.25, -0.1]\nmaximum = [0.5, 0.1]\n",
        "Its limits are those of the recordings",
        "in the order twist.linear.x, twist.linear.z",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let each = |bounds: &[f32]| Some(Bound::Each(bounds.to_vec()));
    assert_eq!(spec.action[0].minimum, each(&[-0.25, -0.1]));
    assert_eq!(spec.action[0].maximum, each(&[0.5, 0.1]));
    assert_eq!(of(&moves).spec.action[0].size, 6);
    let never = of(&|_: &str| range(0.0, 0.0));
    assert_eq!(never.spec.action[0].size, 6, "an action that never moves stays whole");
    assert!(!never.to_string().contains("minimum"), "and has no limits: {never}");
}

/// A planar tool: two of the four numbers of its rotation never change.
#[test]
fn quaternions_of_an_action_stay_whole() {
    for [part, real] in [["orientation.", "w"], ["quat.", "w"], ["", "qw"]] {
        let prefix = if real == "qw" { "q" } else { "" };
        let names = ["x", "y", "z"].map(|axis| format!("{part}{prefix}{axis}"));
        let [x, y, z] = names.each_ref().map(|name| name.as_str());
        let of = |name: &str, high| numbers(&format!("target.{name}"), &[range(0.0, high)]);
        let real = format!("{part}{real}");
        let fields = vec![of("px", 0.4), of(x, 0.0), of(y, 0.0), of(z, 0.3), of(&real, 1.0)];
        let draft = draft([&recording(vec![topic("/cmd", "json", fields)])], &known("t")).unwrap();
        let sizes: u32 = draft.spec.action.iter().map(|field| field.size).sum();
        assert_eq!(sizes, 5, "{draft}");
    }
}
