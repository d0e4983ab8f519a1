//! Values that a setting accepts, and the errors for those it rejects.

use serde_json::json;

use super::*;

fn problem(shape: Shape, value: Value) -> String {
    let setting = Setting { name: "x".into(), about: String::new(), shape, default: Value::Null };
    setting.check(&value).unwrap_err().to_string()
}

fn words() -> Vec<WordAbout> {
    ["a", "b"].map(|word| WordAbout { word: word.into(), about: String::new() }).to_vec()
}

#[test]
fn doubles_without_a_fraction_are_integers() {
    let setting = Setting { name: "n".into(), about: String::new(), shape: integer_in(1, 9), default: json!(1) };
    assert_eq!(setting.check(&json!(3.0)).unwrap(), json!(3));
    assert_eq!(setting.check(&json!(9)).unwrap(), json!(9));
}

#[test]
fn an_invalid_value_is_rejected_with_the_allowed_ones() {
    for (shape, value, expected) in [
        (integer_in(1, 9), json!(0), "x: is 0, must be between 1 and 9"),
        (integer_in(1, 9), json!(2.5), "x: expected a whole number between 1 and 9, got 2.5"),
        (integer_in(0, 9), json!(-1), "x: expected a whole number between 0 and 9, got -1"),
        (number_in(0.0, 1.0), json!("0.5"), "x: expected a number between 0 and 1, got \"0.5\""),
        (Shape::Flag, json!(1), "x: expected true or false, got 1"),
        (Shape::Word { words: words() }, json!("c"), "x: unknown value \"c\"; supported: a, b"),
        (Shape::Words { words: words() }, json!(["a", "a"]), "x: [1] is \"a\" again; name each value once"),
        (Shape::Words { words: words() }, json!([]), "x: has 0 values, must have between 1 and 2"),
        (Shape::Integers { most: 5, count: 2 }, json!([1, 6]), "x: [1] is 6, must be between 0 and 5"),
        // Before any value is looked at.
        (Shape::Integers { most: 5, count: 2 }, json!([1, 2, 1]), "x: has 3 values, must have between 1 and 2"),
        (Shape::Words { words: words() }, json!(["a", "a", "c"]), "x: has 3 values, must have between 1 and 2"),
        (Shape::Text, json!(null), "x: expected a text, got null"),
    ] {
        assert_eq!(problem(shape, value), expected);
    }
    let scale = || Shape::Numbers { names: ["o", "m"].map(str::to_owned).to_vec(), least: 0.0, most: 2.0 };
    assert_eq!(problem(scale(), json!([0, 0])), "x: is 0 for o, m; at least one must be above 0");
    assert_eq!(problem(scale(), json!([1, 3])), "x: m is 3, must be between 0 and 2");
    assert!(problem(scale(), json!([1])).starts_with("x: expected 2 numbers: o, m"));
}

#[test]
fn a_misspelt_setting_is_rejected_with_the_known_ones() {
    let schema = [Setting { name: "batch".into(), about: String::new(), shape: integer_in(1, 9), default: json!(4) }];
    let given = |name: &str| Values::from_iter([(name.to_owned(), json!(2))]);
    let message = complete(&schema, &given("batchs"), |_| None).unwrap_err().to_string();
    assert_eq!(message, "batchs: unknown setting; supported: batch");
    assert_eq!(complete(&schema, &given("batch"), |_| None).unwrap(), given("batch"));
    assert_eq!(complete(&schema, &Values::new(), |_| None).unwrap()["batch"], json!(4));
}

#[test]
fn an_error_repeats_only_the_beginning_of_a_long_value() {
    let long = "x".repeat(1 << 20);
    assert!(problem(Shape::Flag, json!(long)).len() < 200);
    assert!(problem(Shape::Word { words: words() }, json!(long)).len() < 200);
    let given = Values::from_iter([(long, json!(1))]);
    assert!(complete(&[], &given, |_| None).unwrap_err().to_string().len() < 200);
}
