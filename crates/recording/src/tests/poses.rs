//! Poses of frames from a robot's transforms, end to end.

use serde_json::{Value, json};

use super::scene::{Scene, check, numbers_only};
use crate::extract::{Kept, extract};
use crate::{
    Cuts, FieldSpec, FindingCode, Limits, RecordingError, Severity, TaskSpec, TimeRange, Transform, cut, read_episode,
    validate,
};

const COUNT: i64 = 8;

/// The small task with the pose of the tool in place of its position.
fn spec() -> TaskSpec {
    let mut spec = numbers_only();
    spec.proprioception[1] = FieldSpec::new("tool", Transform::SIZE);
    let source = &mut spec.mappings[0].fields[1];
    source.paths.clear();
    "/tf".clone_into(&mut source.topic);
    source.transform =
        Some(Transform { parent: "base".into(), child: "tool".into(), static_topic: "/tf_static".into() });
    spec
}

fn transform(ms: i64, frames: [&str; 2], place: [f64; 3], turn: [f64; 4]) -> Value {
    let ([x, y, z], [qx, qy, qz, qw]) = (place, turn);
    json!({
        "header": { "frame_id": frames[0], "stamp": { "sec": ms / 1000, "nanosec": ms % 1000 * 1_000_000 } },
        "child_frame_id": frames[1],
        "transform": {
            "translation": { "x": x, "y": y, "z": z },
            "rotation": { "x": qx, "y": qy, "z": qz, "w": qw },
        },
    })
}

/// A quarter of a turn about z.
const QUARTER: [f64; 4] = [0.0, 0.0, std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::FRAC_1_SQRT_2];
const NONE: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

/// The arm slides along x, turned by a quarter; a lift moves it up in every fourth step, in a message of its own. The tool
/// is one metre before the arm, which never changes.
fn scene() -> Scene {
    let mut scene = Scene::steps(COUNT).without("/tool");
    let fixed = json!({ "transforms": [transform(0, ["arm", "tool"], [1.0, 0.0, 0.0], NONE)] });
    scene.messages.insert(0, ("/tf_static", None, 0, fixed));
    for at in 0..COUNT {
        let ms = 1000 + at * 100;
        let value = f64::from(i32::try_from(at).unwrap());
        // Stamps are those of the transforms: messages have none, and are logged late.
        let mut add = |transform: Value| {
            scene.messages.push(("/tf", None, ms + 7, json!({ "transforms": [transform] })));
        };
        if at % 4 == 0 {
            add(transform(ms - 1, ["base", "lift"], [0.0, 0.0, value], NONE));
        }
        add(transform(ms, ["lift", "arm"], [value, 0.0, 0.0], QUARTER));
        add(transform(ms, ["odom", "base"], [value, 5.0, 0.0], NONE));
    }
    scene
}

fn tools(values: &[f32]) -> Vec<&[f32]> {
    values.chunks(9).map(|row| &row[2..]).collect()
}

#[test]
fn a_pose_follows_every_link_and_the_fixed_ones() {
    let reading = scene().read(&spec()).unwrap();
    assert_eq!(reading.report.findings, []);
    assert_eq!(reading.report.steps, 8);
    assert!(reading.report.topics.iter().filter(|topic| topic.topic.starts_with("/tf")).all(|topic| topic.used));
    let values = reading.episode.proprioception();
    for (at, found) in tools(&values).into_iter().enumerate() {
        let at = f32::from(u8::try_from(at).unwrap());
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let wanted = [at, 1.0, (at / 4.0).floor() * 4.0, 0.0, 0.0, half, half];
        assert!(found.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-6), "{found:?} {wanted:?}");
    }
}

#[test]
fn a_stretch_has_the_transforms_on_which_its_poses_depend() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    std::fs::write(&path, scene().mcap()).unwrap();
    extract(&path, &spec(), &Kept::unscored(2, 4), &out).unwrap();
    let read = |path| read_episode(path, &spec()).unwrap().episode;
    let (whole, part) = (read(&path), read(&out));
    assert_eq!(part.stamps(), &whole.stamps()[2..6]);
    assert_eq!(part.proprioception(), whole.proprioception()[2 * 9..6 * 9]);

    let mut clocked = spec();
    clocked.mappings[0].clock = Some("/tf".into());
    let error = extract(&path, &clocked, &Kept::unscored(2, 4), &folder.path().join("c.mcap")).unwrap_err();
    assert!(matches!(&error, RecordingError::Spec { problem, .. } if problem.contains("a topic of transforms")));
    let steps = read_episode(&path, &clocked).unwrap().episode.stamps().len();
    extract(&path, &clocked, &Kept::unscored(0, steps), &out).unwrap();
}

#[test]
fn a_frame_that_is_missing_is_named_with_those_that_are_there() {
    let refused = |spec: &TaskSpec, scene: &Scene| {
        check(&scene.report(spec), Severity::Error, FindingCode::MissingField, "tool").detail
    };
    let mut other = spec();
    let own = other.mappings[0].fields[1].transform.as_mut().unwrap();
    "gripper".clone_into(&mut own.child);
    let detail = refused(&other, &scene());
    assert!(detail.contains("there is no frame `gripper`; the frames are arm, base, lift, odom, tool"), "{detail}");
    let own = other.mappings[0].fields[1].transform.as_mut().unwrap();
    "arm".clone_into(&mut own.parent);
    "tool".clone_into(&mut own.child);
    let detail = refused(&other, &scene());
    assert!(detail.contains("the transforms between them never change"), "{detail}");
    let detail = refused(&spec(), &scene().without("/tf_static"));
    assert!(detail.contains("there is no frame `tool`"), "{detail}");
    // A transform with a zero quaternion is left out, and here no other connects the frames.
    let broken = scene().change_all("/tf", |content| content["transforms"][0]["transform"]["rotation"] = json!({}));
    let detail = refused(&spec(), &broken);
    assert!(detail.contains("was left out: its quaternion is zero"), "{detail}");
    let mut once = scene();
    once.add("/tf", 1450, json!({ "transforms": [transform(1450, ["lift", "arm"], [9.0, 9.0, 9.0], [0.0; 4])] }));
    let values = |scene: &Scene| scene.read(&spec()).unwrap().episode.proprioception();
    assert_eq!(values(&once), values(&scene()), "the transform before it stays");
}

#[test]
fn mappings_of_the_same_topics_have_trees_of_their_own() {
    // The same topics with the frames of another robot come first and do not fit.
    let mut several = spec();
    let mut other = several.mappings[0].clone();
    "other".clone_into(&mut other.name);
    let frames = other.fields[1].transform.as_mut().unwrap();
    "panda_link0".clone_into(&mut frames.parent);
    "hand".clone_into(&mut frames.child);
    several.mappings.insert(0, other);
    let reading = scene().read(&several).unwrap();
    assert_eq!(reading.report.mapping, spec().mappings[0].name);
    assert_eq!(reading.episode.proprioception(), scene().read(&spec()).unwrap().episode.proprioception());
    // A mapping without static transforms does not see those of another.
    let mut none = spec();
    none.mappings[0].fields[1].transform.as_mut().unwrap().static_topic.clear();
    let mut both = none.clone();
    let mut with = spec().mappings[0].clone();
    "with".clone_into(&mut with.name);
    with.fields[0].paths = vec!["missing".into()];
    both.mappings.push(with);
    for spec in [none, both] {
        let report = scene().report(&spec);
        assert!(
            report.findings.iter().any(|finding| finding.detail.contains("there is no frame `tool`")),
            "{report:?}"
        );
    }
}

#[test]
fn an_episode_that_is_cut_out_has_the_transforms_that_never_change() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.mcap");
    std::fs::write(&path, scene().mcap()).unwrap();
    let ranges = [TimeRange { start_s: 1.0, end_s: 1.4, success: None }];
    let cut = cut(&path, Cuts::Ranges(&ranges), &Limits::default(), folder.path()).unwrap();
    let episode = read_episode(&folder.path().join(&cut[0].file_name), &spec()).unwrap().episode;
    let whole = read_episode(&path, &spec()).unwrap().episode;
    assert_eq!(episode.stamps(), &whole.stamps()[..4]);
    assert_eq!(episode.proprioception(), whole.proprioception()[..4 * 9]);
}

#[test]
fn a_transform_is_checked_with_the_task() {
    validate(&spec()).unwrap();
    let problem = |change: &dyn Fn(&mut TaskSpec)| {
        let mut spec = spec();
        change(&mut spec);
        validate(&spec).unwrap_err().to_string()
    };
    let field = "mappings[0].fields[1].";
    fn of(spec: &mut TaskSpec) -> &mut Transform {
        spec.mappings[0].fields[1].transform.as_mut().unwrap()
    }
    for (change, wanted) in [
        (&|spec: &mut TaskSpec| spec.proprioception[1].size = 3, "transform: a pose has 7 values"),
        (&|spec: &mut TaskSpec| spec.mappings[0].fields[1].paths.push("x".into()), "paths: a field with a `transform`"),
        (&|spec: &mut TaskSpec| of(spec).parent.clear(), "transform.parent: give the frame"),
        (&|spec: &mut TaskSpec| "base".clone_into(&mut of(spec).child), "transform.child: `base` is the parent, too"),
        (&|spec: &mut TaskSpec| "\n".clone_into(&mut of(spec).static_topic), "transform.static_topic: give the topic"),
    ] as [(&dyn Fn(&mut TaskSpec), &str); 5]
    {
        let found = problem(change);
        assert!(found.contains(&format!("{field}{wanted}")), "{found}");
    }
}
