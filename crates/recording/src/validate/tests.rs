//! Tests of the parent module.

use super::*;
use crate::Bound;
use crate::testing::arm;

fn problem(change: impl FnOnce(&mut TaskSpec)) -> String {
    let mut spec = arm();
    change(&mut spec);
    validate(&spec).unwrap_err().to_string()
}

#[test]
fn accepts_a_sound_task() {
    validate(&arm()).unwrap();
}

#[test]
fn names_the_field_that_is_wrong() {
    assert!(problem(|s| s.rate_hz = f64::NAN).contains("rate_hz"));
    assert!(problem(|s| s.tolerance = 0.6).contains("tolerance"));
    assert!(problem(|s| s.name.clear()).contains("name"));
    assert!(problem(|s| s.action.clear()).contains("action"));
    assert!(problem(|s| s.cameras[0].height = 0).contains("cameras[0].height"));
    assert!(problem(|s| s.proprioception[0].name = "timestamp".into()).contains("proprioception[0].name"));
    assert!(problem(|s| s.action[0].name = "joint_position".into()).contains("action[0].name"));
    assert!(problem(|s| s.mappings[0].cameras.clear()).contains("`front` has no source"));
    assert!(problem(|s| s.mappings[0].fields[0].field = "elbow".into()).contains("no field `elbow`"));
    assert!(problem(|s| s.mappings[0].fields[0].paths = vec!["a[".into()]).contains("fields[0].paths[0]"));
    assert!(problem(|s| s.mappings[0].fields[0].names = vec!["a".into()]).contains("names"));
    assert!(problem(|s| s.mappings[0].fields[0].topic = "/a\n".into()).contains("fields[0].topic"));
    assert!(problem(|s| s.mappings[0].cameras[0].color = "x".repeat(2000)).contains("cameras[0].color"));
    assert!(problem(|s| s.mappings[0].cameras[0].depth = Some(String::new())).contains("cameras[0].depth"));
    assert!(problem(|s| s.mappings[0].clock = Some("\u{7}".into())).contains("mappings[0].clock"));
}

#[test]
fn ranges_are_of_actions_and_complete() {
    let range = |minimum: Option<f32>, maximum: Option<f32>, binary| {
        let (minimum, maximum) = (minimum.map(Bound::All), maximum.map(Bound::All));
        move |spec: &mut TaskSpec| {
            let name = spec.action[0].name.clone();
            spec.action[0] =
                FieldSpec { minimum: minimum.clone(), maximum: maximum.clone(), binary, ..FieldSpec::new(name, 2) };
        }
    };
    for right in [range(Some(-1.0), Some(1.0), true), range(None, Some(1.0), false), range(Some(0.0), None, false)] {
        let mut spec = arm();
        right(&mut spec);
        validate(&spec).unwrap();
    }
    assert!(problem(range(Some(1.0), Some(1.0), false)).contains("action[0].maximum: 1 is not above the minimum 1"));
    assert!(problem(range(Some(1.0), None, true)).contains("action[0].binary"));
    assert!(problem(range(None, None, true)).contains("action[0].binary"));
    assert!(problem(range(Some(f32::NAN), None, false)).contains("action[0].minimum"));
    assert!(problem(|s| s.proprioception[0].maximum = Some(Bound::All(1.0))).contains("proprioception[0].minimum"));
    // The action has two values.
    let each = |minimum: &[f32], maximum: &[f32]| {
        let [minimum, maximum] = [minimum, maximum].map(|bounds| Some(Bound::Each(bounds.to_vec())));
        move |spec: &mut TaskSpec| {
            let name = spec.action[0].name.clone();
            spec.action[0] =
                FieldSpec { minimum: minimum.clone(), maximum: maximum.clone(), ..FieldSpec::new(name, 2) };
        }
    };
    let mut spec = arm();
    each(&[-1.0, -0.1], &[1.0, 0.1])(&mut spec);
    validate(&spec).unwrap();
    let few = problem(each(&[-1.0], &[1.0, 0.1]));
    assert!(few.contains("action[0].minimum: has 1 numbers for 2 values; give one for each"), "{few}");
    assert!(problem(each(&[], &[1.0, 0.1])).contains("action[0].minimum: has 0 numbers"));
    assert!(problem(each(&[-1.0, -1.0], &[1.0, f32::INFINITY])).contains("action[0].maximum: give finite"));
    assert!(problem(each(&[-1.0, 0.5], &[1.0, 0.1])).contains("0.1 is not above the minimum 0.5 (value 1)"));
}

#[test]
fn lists_are_limited() {
    assert!(problem(|s| s.cameras = vec![s.cameras[0].clone(); 17]).contains("cameras: has 17"));
    assert!(problem(|s| s.action = vec![s.action[0].clone(); 257]).contains("action: has 257"));
    assert!(problem(|s| s.mappings = vec![s.mappings[0].clone(); 33]).contains("mappings: has 33"));
    assert!(problem(|s| s.mappings[0].fields[0].paths = vec!["a".into(); 3]).contains("fields[0].paths: has 3"));
    assert!(problem(|s| s.mappings[0].fields[0].names = vec!["a".into(); 3]).contains("fields[0].names: has 3"));
}

#[test]
fn images_may_be_limited_further() {
    let limits = |image_pixels| Limits { image_pixels, ..Limits::default() };
    assert!(validate_within(&arm(), &limits(8 * 16)).is_ok());
    let problem = validate_within(&arm(), &limits(8 * 16 - 1)).unwrap_err().to_string();
    assert!(problem.contains("cameras[0]: 128 pixels"), "{problem}");
}
