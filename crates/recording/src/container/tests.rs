//! Tests of the container: whole files, cut ones, and damage.

use std::collections::BTreeMap;

use mcap::records::{MessageHeader, op};

use super::*;

fn scan_bytes(bytes: &[u8]) -> (Result<Ending, RecordingError>, usize) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, bytes).unwrap();
    let mut messages = 0;
    let scanned = scan(&path, &Limits::default(), &mut |record| {
        messages += usize::from(matches!(record, Record::Message { .. }));
        Ok(())
    });
    (scanned.map(|scanned| scanned.ending), messages)
}

fn ten_messages(options: mcap::WriteOptions) -> Vec<u8> {
    let mut writer = options.create(std::io::Cursor::new(Vec::new())).unwrap();
    let channel = writer.add_channel(0, "/x", "json", &BTreeMap::new()).unwrap();
    for i in 0..10u32 {
        let time = u64::from(i);
        let header = MessageHeader { channel_id: channel, sequence: i, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, b"{\"a\":1}").unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn reads_whole_files() {
    for options in [
        mcap::WriteOptions::new(),
        mcap::WriteOptions::new().compression(Some(mcap::Compression::Lz4)),
        mcap::WriteOptions::new().compression(None),
        mcap::WriteOptions::new().use_chunks(false),
    ] {
        let (ending, messages) = scan_bytes(&ten_messages(options));
        assert_eq!((ending.unwrap(), messages), (Ending::Whole, 10));
    }
}

#[test]
fn truncated_file_keeps_its_complete_messages() {
    let bytes = ten_messages(mcap::WriteOptions::new().use_chunks(false));
    let mut last = 0;
    for cut in 8..bytes.len() {
        let (ending, messages) = scan_bytes(&bytes[..cut]);
        assert_eq!(ending.unwrap(), Ending::Cut, "cut at {cut}");
        assert!(messages >= last, "cut at {cut}");
        last = messages;
    }
    assert_eq!(last, 10);
}

#[test]
fn empty_and_other_files_are_refused() {
    assert!(matches!(scan_bytes(b"").0, Err(RecordingError::Empty { .. })));
    assert!(matches!(scan_bytes(b"PK\x03\x04 a zip file, say").0, Err(RecordingError::NotMcap { .. })));
}

#[test]
fn a_changed_byte_in_a_chunk_is_damage() {
    let mut bytes = ten_messages(mcap::WriteOptions::new().compression(None));
    let at = bytes.windows(7).position(|window| window == b"{\"a\":1}").unwrap();
    bytes[at + 5] = b'2';
    assert!(matches!(scan_bytes(&bytes).0, Err(RecordingError::Damaged { .. })));
}

#[test]
fn a_string_longer_than_its_record_is_damage() {
    let mut bytes = mcap::MAGIC.to_vec();
    bytes.extend([op::SCHEMA, 8, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0xff, 0xff, 0xff, 0xff, b'a', b'b']);
    assert!(matches!(scan_bytes(&bytes).0, Err(RecordingError::Damaged { .. })));
}
