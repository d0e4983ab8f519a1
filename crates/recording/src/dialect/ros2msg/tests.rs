//! Tests of the parent module.

use super::*;

fn fields(text: &str) -> Vec<(String, Kind, Count)> {
    let parsed = Definitions::parse("lab_msgs/msg/Top", text).unwrap();
    parsed.messages[0].fields.iter().map(|field| (field.name.clone(), field.kind, field.count)).collect()
}

#[test]
fn keeps_fields_and_drops_constants_defaults_and_comments() {
    let text = "# a comment\nint32 X=5\nint32 Y = 6 # six\nstring WORD=\"a#b\"\n\nfloat64 speed 1.5 # m/s\n\
                string<=10 label \"x\"\nuint8[<=4] bounded\nstring<=5[3] words\nint16[] open [1, 2]\nbool\tflag";
    let expected = [
        ("speed", Kind::Scalar(Scalar::F64), Count::One),
        ("label", Kind::Text, Count::One),
        ("bounded", Kind::Scalar(Scalar::U8), Count::Counted),
        ("words", Kind::Text, Count::Fixed(3)),
        ("open", Kind::Scalar(Scalar::I16), Count::Counted),
        ("flag", Kind::Scalar(Scalar::Bool), Count::One),
    ];
    assert_eq!(fields(text), expected.map(|(name, kind, count)| (name.to_owned(), kind, count)));
}

#[test]
fn finds_dependencies_by_full_short_and_local_name() {
    let line = "=".repeat(80);
    let text = format!(
        "std_msgs/Header header\nPart near\nother_msgs/msg/Far far\n{line}\nMSG: lab_msgs/Part\nint8 a\n\
         {line}\nMSG: other_msgs/Far\nbuiltin_interfaces/Time t\n"
    );
    let parsed = Definitions::parse("lab_msgs/msg/Top", &text).unwrap();
    let kinds: Vec<Kind> = parsed.messages[0].fields.iter().map(|field| field.kind).collect();
    let Kind::Message(header) = kinds[0] else { panic!("header is no message") };
    assert_eq!(parsed.messages[header].fields[1].name, "frame_id");
    assert_eq!(kinds[1..], [Kind::Message(1), Kind::Message(2)]);
}

#[test]
fn names_the_line_that_is_wrong() {
    for (text, what) in [
        ("float64", "no field name"),
        ("Unknown x", "`Unknown` is not defined"),
        ("int8[0] x", "size 0"),
        ("int8[x] x", "not a number"),
        ("int8[3 x", "not closed"),
        ("int8 x-y", "no field name"),
    ] {
        let problem = Definitions::parse("lab_msgs/msg/Top", text).unwrap_err();
        assert!(problem.contains(what) && problem.contains(text), "{problem}");
    }
}
