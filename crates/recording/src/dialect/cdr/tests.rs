//! Tests of the parent module.

use super::*;

fn decode(schema: &str, bytes: &[u8]) -> Result<String, String> {
    let decoder = Decoder::new("lab_msgs/msg/Top", schema.as_bytes()).unwrap();
    decoder.decode(bytes).map(|value| format!("{value:?}"))
}

fn value<'a>(decoder: &'a Decoder, bytes: &'a [u8]) -> Value<'a> {
    decoder.decode(bytes).unwrap()
}

#[test]
fn aligns_to_each_primitive_in_both_byte_orders() {
    let decoder = Decoder::new("p/msg/T", b"uint8 a\nint16 b\nfloat64 c\nint8 d\nfloat32 e").unwrap();
    let little = [
        &[0, 1, 0, 0, 7, 0, 0xfe, 0xff, 0, 0, 0, 0][..],
        &1.5f64.to_le_bytes(),
        &[0xff, 0, 0, 0],
        &2.5f32.to_le_bytes(),
    ];
    let big = [
        &[0, 0, 0, 0, 7, 0, 0xff, 0xfe, 0, 0, 0, 0][..],
        &1.5f64.to_be_bytes(),
        &[0xff, 0, 0, 0],
        &2.5f32.to_be_bytes(),
    ];
    for bytes in [little.concat(), big.concat()] {
        let value = value(&decoder, &bytes);
        let numbers = ["a", "b", "c", "d", "e"].map(|name| value.number(name).unwrap());
        assert_eq!(numbers, [7.0, -2.0, 1.5, -1.0, 2.5]);
    }
}

#[test]
fn reads_text_wide_text_and_every_kind_of_array() {
    let decoder =
        Decoder::new("p/msg/T", b"string s\nwstring w\nuint8[] b\nint16[2] f\nstring[] l\nbool[<=3] o").unwrap();
    let bytes = [
        &[0, 1, 0, 0, 3, 0, 0, 0, b'h', b'i', 0, 0][..], // s, padded to 4
        &[1, 0, 0, 0, 0xe9, 0, 0, 0],                    // w = é
        &[3, 0, 0, 0, 9, 8, 7, 0],                       // b, padded to 2
        &[1, 0, 2, 0],                                   // f
        &[1, 0, 0, 0, 2, 0, 0, 0, b'x', 0, 0, 0],        // l, padded to 4
        &[2, 0, 0, 0, 1, 0],                             // o
    ]
    .concat();
    let value = value(&decoder, &bytes);
    assert_eq!((value.text("s"), value.text("w")), (Some("hi"), Some("é")));
    assert_eq!(value.bytes("b"), Some(&[9, 8, 7][..]));
    assert_eq!(value.field("f"), Some(&Value::Numbers(vec![1.0, 2.0])));
    assert_eq!(value.field("l"), Some(&Value::List(vec![Value::Text("x".into())])));
    assert_eq!(value.field("o"), Some(&Value::Numbers(vec![1.0, 0.0])));
}

#[test]
fn an_empty_message_takes_one_byte() {
    let schema = format!("Nothing n\nuint8 x\n{}\nMSG: lab_msgs/Nothing\nint8 LIMIT=3", "=".repeat(80));
    let decoder = Decoder::new("lab_msgs/msg/Top", schema.as_bytes()).unwrap();
    assert_eq!(value(&decoder, &[0, 1, 0, 0, 0, 5]).number("x"), Some(5.0));
}

#[test]
fn refuses_lengths_beyond_the_bytes_without_reserving() {
    assert!(decode("float64[] a", &[0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff]).unwrap_err().contains("`a`: 4294967295"));
    assert!(decode("string a", &[0, 1, 0, 0, 9, 0, 0, 0, 1]).unwrap_err().contains("9 bytes are needed"));
    assert!(decode("wstring a", &[0, 1, 0, 0, 9, 0, 0, 0, 1]).unwrap_err().contains("wide"));
    assert!(decode("int8[4000000000] a", &[0, 1, 0, 0, 9]).unwrap_err().contains("4000000000"));
    assert!(decode("float64 a", &[0, 1, 0, 0, 9]).is_err());
    assert!(decode("int8 a", &[0, 1]).unwrap_err().contains("encapsulation header"));
    assert!(decode("int8 a", &[0, 3, 0, 0, 9]).unwrap_err().contains("00 03"));
}

#[test]
fn recursive_type_is_refused() {
    let schema = format!("Loop a\n{}\nMSG: lab_msgs/Loop\nLoop again", "=".repeat(80));
    assert!(decode(&schema, &[0, 1, 0, 0, 1, 2, 3]).unwrap_err().contains("nested"));
}

/// Found by the differential suite: a changed final byte made another joint name, and its values were left out.
#[test]
fn a_text_without_its_final_zero_is_refused() {
    let text = |last: u8| decode("string a", &[0, 1, 0, 0, 2, 0, 0, 0, b'b', last]);
    assert!(text(0).unwrap().contains("\"b\""));
    assert!(text(4).unwrap_err().contains("does not end with a zero"));
    assert!(decode("string a", &[0, 1, 0, 0, 0, 0, 0, 0]).unwrap().contains("\"\""));
}
