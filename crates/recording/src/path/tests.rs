//! Tests of the parent module.

use super::*;

fn joints() -> Value<'static> {
    Value::Message(vec![
        ("name".into(), Value::List(vec![Value::Text("b".into()), Value::Text("a".into())])),
        ("position".into(), Value::Numbers(vec![2.0, 1.0])),
        ("effort".into(), Value::Numbers(vec![])),
        ("pose".into(), Value::Message(vec![("x".into(), Value::Number(7.0))])),
        ("raw".into(), Value::Bytes(vec![3, 4, 5].into())),
        (
            "each".into(),
            Value::List(vec![
                Value::Message(vec![("name".into(), Value::Text("p".into())), ("v".into(), Value::Number(10.0))]),
                Value::Message(vec![("name".into(), Value::Text("q".into())), ("v".into(), Value::Number(20.0))]),
            ]),
        ),
    ])
}

fn numbers(path: &str) -> Result<Vec<f64>, Missing> {
    let mut out = Vec::new();
    Path::parse(path).unwrap().numbers(&joints(), &mut out).map(|()| out)
}

fn by_name(path: &str, names: &[&str]) -> Result<Vec<f64>, Missing> {
    let names: Vec<String> = names.iter().map(|&name| name.into()).collect();
    let mut out = Vec::new();
    Path::parse(path).unwrap().numbers_by_name(&joints(), &names, &mut out).map(|()| out)
}

#[test]
fn picks_scalars_arrays_elements_and_ranges() {
    assert_eq!(numbers("pose.x").unwrap(), [7.0]);
    assert_eq!(numbers("position").unwrap(), [2.0, 1.0]);
    assert_eq!(numbers("position[1]").unwrap(), [1.0]);
    assert_eq!(numbers("raw[1:3]").unwrap(), [4.0, 5.0]);
    assert_eq!(numbers("each.v").unwrap(), [10.0, 20.0]);
    assert_eq!(numbers("each[1].v").unwrap(), [20.0]);
}

#[test]
fn picks_by_name_in_the_wanted_order() {
    assert_eq!(by_name("position", &["a", "b"]).unwrap(), [1.0, 2.0]);
    assert_eq!(by_name("position", &["b"]).unwrap(), [2.0]);
    assert_eq!(by_name("each.v", &["q", "p"]).unwrap(), [20.0, 10.0]);
    assert!(matches!(by_name("position", &["c"]), Err(Missing::Names(_))));
    assert!(matches!(by_name("effort", &["a"]), Err(Missing::Path(_))));
}

#[test]
fn error_names_the_missing_field_and_the_existing_ones() {
    let Err(Missing::Path(problem)) = numbers("velocity") else { panic!("found a velocity") };
    assert!(problem.contains("`velocity`") && problem.contains("position"), "{problem}");
    assert!(matches!(numbers("position[2]"), Err(Missing::Path(_))));
    assert!(matches!(numbers("position[0:3]"), Err(Missing::Path(_))));
    assert!(matches!(numbers("name"), Err(Missing::Path(_))));
    assert!(matches!(numbers("pose"), Err(Missing::Path(_))));
}

#[test]
fn malformed_paths_are_rejected() {
    for text in ["", ".", "a..b", "a[", "a[]", "a[1", "a[x]", "a[-1]", "a[3:3]", "a[1]b", "a b"] {
        assert!(Path::parse(text).is_err(), "{text}");
    }
}
