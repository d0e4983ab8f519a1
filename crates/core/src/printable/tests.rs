//! Tests of the escaped characters, the form of the escapes, and writes that are split at any byte.

use super::*;

const HOSTILE: &str =
    "\u{1b}]0;x\u{7}\u{1b}[2J\u{9b}31m\u{202e}fdp.exe\u{2069}\u{200f}\u{feff}\u{2028}\u{e0041}\u{7f}\0";

#[test]
fn ordinary_text_of_any_language_is_unchanged_and_not_copied() {
    for text in ["pick_cube 01.mcap", "Größe 2 µm – „gut“", "抓取 立方体", "عربي עברית", "e\u{301} ❤\u{fe0f} 🤖 \u{a0}"]
    {
        assert!(matches!(Escape::Field.apply(text), Cow::Borrowed(same) if same == text), "{text}");
    }
}

#[test]
fn control_bidirectional_and_invisible_characters_become_visible() {
    assert_eq!(
        field(HOSTILE),
        "\\u{1b}]0;x\\u{7}\\u{1b}[2J\\u{9b}31m\\u{202e}fdp.exe\\u{2069}\\u{200f}\\u{feff}\\u{2028}\\u{e0041}\\u{7f}\\u{0}"
    );
    for character in (0..=0x1f).chain(0x7f..=0x9f).chain(0x200b..=0x200f).chain(0x2028..=0x202e).chain(0x2066..=0x2069)
    {
        assert!(!is_printable(char::from_u32(character).unwrap()), "U+{character:04X}");
    }
}

#[test]
fn a_field_stays_on_its_line_and_lines_keep_their_breaks() {
    assert_eq!(field("a\nerror: b\r\tc"), "a\\nerror: b\\r\\tc");
    assert_eq!(Escape::Lines.apply("a\n\tb\r\u{1b}"), "a\n\tb\\r\\u{1b}");
}

#[test]
fn json_reads_back_as_the_same_text() {
    let document = serde_json::to_string_pretty(&serde_json::json!({ "name": HOSTILE, "odd": "\\ \" 🤖" })).unwrap();
    let escaped = Escape::Json.apply(&document);
    assert!(escaped.chars().all(|character| is_printable(character) || character == '\n'), "{escaped}");
    let read: serde_json::Value = serde_json::from_str(&escaped).unwrap();
    assert_eq!((read["name"].as_str(), read["odd"].as_str()), (Some(HOSTILE), Some("\\ \" 🤖")));
}

#[test]
fn a_line_written_as_a_field_keeps_only_its_last_break() {
    let mut out = Vec::new();
    let mut writer = EscapingWriter::new(&mut out, Escape::Field).with_colours(true);
    writer.write_all(b"\x1b[2mnow\x1b[0m a\n2026 ERROR forged\n").unwrap();
    writer.write_all(b"next\n").unwrap();
    assert_eq!(out, b"\x1b[2mnow\x1b[0m a\\n2026 ERROR forged\nnext\n");
}

fn written(parts: &[&[u8]], colours: bool) -> String {
    let mut out = Vec::new();
    let mut writer = EscapingWriter::new(&mut out, Escape::Lines).with_colours(colours);
    for part in parts {
        writer.write_all(part).unwrap();
    }
    writer.flush().unwrap();
    String::from_utf8(out).unwrap()
}

#[test]
fn a_writer_escapes_characters_that_arrive_in_pieces() {
    let text = format!("é {HOSTILE} 🤖\n");
    for cut in 0..=text.len() {
        let (first, second) = text.as_bytes().split_at(cut);
        assert_eq!(written(&[first, second], false), Escape::Lines.apply(&text), "cut at {cut}");
    }
    assert_eq!(written(&[b"a\xffb", b"\xf0\x9f"], false), "a\u{fffd}b\u{fffd}");
}

#[test]
fn colours_are_kept_only_if_enabled_and_other_sequences_are_escaped() {
    let coloured = b"\x1b[1;32mINFO\x1b[0m \x1b[2J\x1b]0;x\x07 \x1b[31 \x1b[";
    assert_eq!(written(&[coloured], true), "\u{1b}[1;32mINFO\u{1b}[0m \\u{1b}[2J\\u{1b}]0;x\\u{7} \\u{1b}[31 \\u{1b}[");
    assert!(!written(&[coloured], false).contains('\u{1b}'));
}
