//! Tests of the parent module.

use std::borrow::Cow;

use super::*;

fn numbers(names: &[&'static str], values: &[f64]) -> Value<'static> {
    Value::Message(names.iter().zip(values).map(|(name, value)| ((*name).into(), Value::Number(*value))).collect())
}

fn text(text: &'static str) -> Value<'static> {
    Value::Text(text.into())
}

fn message(fields: Vec<(&'static str, Value<'static>)>) -> Value<'static> {
    Value::Message(fields.into_iter().map(|(name, value)| (Cow::Borrowed(name), value)).collect())
}

fn parts(place: [f64; 3], turn: [f64; 4]) -> Vec<(&'static str, Value<'static>)> {
    let (place, turn) = (numbers(&["x", "y", "z"], &place), numbers(&["x", "y", "z", "w"], &turn));
    vec![("translation", place), ("rotation", turn)]
}

/// A transform as ROS has it.
fn ros(parent: &'static str, child: &'static str, place: [f64; 3], turn: [f64; 4]) -> Value<'static> {
    let header = message(vec![("frame_id", text(parent))]);
    let transform = message(parts(place, turn));
    message(vec![("header", header), ("child_frame_id", text(child)), ("transform", transform)])
}

/// A transform as foxglove has it.
fn foxglove(parent: &'static str, child: &'static str, place: [f64; 3], turn: [f64; 4]) -> Value<'static> {
    let mut fields = vec![("parent_frame_id", text(parent)), ("child_frame_id", text(child))];
    fields.extend(parts(place, turn));
    message(fields)
}

fn list(transforms: Vec<Value<'static>>) -> Value<'static> {
    message(vec![("transforms", Value::List(transforms))])
}

/// A tool on an arm on a root, beside which there is a camera; quaternions of any length.
fn tree() -> Tree {
    let mut tree = Tree::default();
    let arm = ros("/root", "arm", [0.1, 0.2, 0.3], [1.0, 2.0, 3.0, 4.0]);
    let tool = foxglove("arm", "/tool", [0.5, -0.4, 0.2], [-2.0, 1.0, 0.0, 3.0]);
    tree.update(&list(vec![arm])).unwrap();
    tree.update(&tool).unwrap();
    tree.update(&list(vec![ros("root", "camera", [-0.3, 0.6, 0.9], [0.0, 1.0, 1.0, 5.0])])).unwrap();
    tree
}

#[track_caller]
fn check(found: &Result<Pose, Missing>, wanted: [f64; 7]) {
    let found = found.as_ref().unwrap().numbers();
    assert!(found.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-8), "{found:?}");
}

/// Against products of matrices, computed apart.
#[test]
fn poses_are_composed_up_and_down_the_tree() {
    let tree = tree();
    let in_root = [0.58, 0.56, 0.0, -0.390_360_029, 0.195_180_015, 0.683_130_051, 0.585_540_044];
    check(&tree.pose("root", "tool", 0), in_root);
    let in_camera =
        [1.068_148_148, -0.429_629_630, -0.510_370_370, -0.469_530_142, 0.150_249_645, 0.469_530_142, 0.732_467_021];
    check(&tree.pose("/camera", "tool", 0), in_camera);
    let there = tree.pose("camera", "tool", 0).unwrap();
    let back = tree.pose("tool", "camera", 0).unwrap();
    check(&Ok(there.then(&back)), Pose::SAME.numbers());
}

#[test]
fn only_a_change_between_the_frames_gives_a_pose() {
    let mut tree = tree();
    let before = tree.update(&ros("root", "camera", [0.0; 3], [0.0, 0.0, 0.0, 1.0])).unwrap();
    assert_eq!(tree.pose("root", "tool", before), Err(Missing::Unchanged));
    assert!(tree.pose("camera", "tool", before).is_ok());
    let before = tree.update(&list(Vec::new())).unwrap();
    assert_eq!(tree.pose("camera", "tool", before), Err(Missing::Unchanged));
}

#[test]
fn numbers_that_protobuf_leaves_out_are_zero_and_a_rotation_is_none() {
    let mut tree = Tree::default();
    let moved = message(vec![
        ("parent_frame_id", text("a")),
        ("child_frame_id", text("b")),
        ("translation", numbers(&["x"], &[2.0])),
    ]);
    tree.update(&moved).unwrap();
    check(&tree.pose("a", "b", 0), [2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
}

#[test]
fn what_is_missing_is_named() {
    let mut tree = tree();
    let gap = |tree: &Tree, parent, child| {
        assert_eq!(tree.pose(parent, child, 0), Err(Missing::Chain));
        tree.gap(parent, child)
    };
    assert_eq!(Tree::default().gap("root", "tool"), "there are no transforms");
    assert_eq!(gap(&tree, "root", "tool0"), "there is no frame `tool0`; the frames are arm, camera, root, tool");
    tree.update(&ros("world", "table", [0.0; 3], [0.0, 0.0, 0.0, 1.0])).unwrap();
    assert!(gap(&tree, "table", "tool").starts_with("no transforms connect `tool` with `table`; the frames are arm,"));
    let (before, there) = (tree.pose("root", "tool", 0), tree.update(&ros("arm", "tool", [0.0; 3], [0.0; 4])));
    assert_eq!(tree.pose("root", "tool", 0), before, "a transform with a zero quaternion is left out");
    assert_eq!(tree.pose("root", "tool", there.unwrap()), Err(Missing::Unchanged));
    let gap = tree.gap("root", "tool0");
    assert!(gap.ends_with("; a transform from `arm` to `tool` was left out: its quaternion is zero"), "{gap}");
    let long = Value::Text("x".repeat(256).into());
    let long = message(vec![("parent_frame_id", text("a")), ("child_frame_id", long)]);
    assert!(tree.update(&long).unwrap_err().contains("more than 255 bytes"));
}

#[test]
fn frames_in_a_circle_and_endless_ones_end() {
    let mut tree = Tree::default();
    let still = |parent, child| ros(parent, child, [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    tree.update(&list(vec![still("a", "b"), still("b", "a"), still("c", "c")])).unwrap();
    assert!(tree.pose("c", "a", 0).is_err());
    assert_eq!(tree.pose("a", "a", 0), Err(Missing::Unchanged));
    let names: Vec<String> = (0..=MAX_FRAMES).map(|at| format!("frame {at}")).collect();
    let chain = names.windows(2).map(|pair| {
        let header = Value::Message(vec![("frame_id".into(), Value::Text(pair[0].clone().into()))]);
        Value::Message(vec![("header".into(), header), ("child_frame_id".into(), Value::Text(pair[1].clone().into()))])
    });
    let mut tree = Tree::default();
    tree.update(&Value::Message(vec![("transforms".into(), Value::List(chain.collect()))])).unwrap();
    assert!(tree.pose("frame 0", "frame 60", 0).is_ok());
    assert_eq!(tree.pose("frame 0", "frame 9000", 0), Err(Missing::Chain), "deeper than any robot");
    assert!(tree.update(&still("a", "one more")).unwrap_err().contains("more than 10000 frames"));
}

#[test]
fn messages_without_transforms_are_refused() {
    let mut tree = Tree::default();
    let refused = |tree: &mut Tree, message| tree.update(&message).unwrap_err();
    assert!(refused(&mut tree, message(vec![("data", Value::Number(1.0))])).contains("no `child_frame_id`"));
    assert!(refused(&mut tree, message(vec![("transforms", Value::Number(1.0))])).contains("not a list"));
    assert!(refused(&mut tree, list(vec![Value::Number(1.0)])).contains("a number has no `child_frame_id`"));
}
