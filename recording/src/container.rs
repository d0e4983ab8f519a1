//! The MCAP container: a file's records in order, with every length checked.
//!
//! Records are read one at a time, so memory follows the largest record, not the file. Knows nothing of
//! dialects or tasks.

mod chunks;
mod record;

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use mcap::McapError;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::error::RecordingError;
use crate::limits::Limits;

pub(crate) use record::Record;

/// Bytes asked of the file at once.
const READ_BYTES: usize = 256 << 10;

/// How a file ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// At the closing magic bytes.
    Whole,
    /// In the middle; every record before the cut was visited.
    Cut,
}

/// Takes a record.
type Visit<'a> = &'a mut dyn FnMut(Record<'_>) -> Result<(), RecordingError>;

/// Hands every record of the file to `visit`, in the file's order.
///
/// # Errors
/// Those of `visit`; [`RecordingError::Io`], `Empty`, `NotMcap`, `TooLarge` and `Damaged`.
pub(crate) fn scan(path: &Path, limits: &Limits, visit: Visit<'_>) -> Result<Ending, RecordingError> {
    scan_with(LinearReaderOptions::default().with_validate_chunk_crcs(true), path, limits, visit)
}

/// As [`scan`], but nothing of a chunk is visited unless all of it is there and is what its checksum says: for what is
/// taken over although the file is damaged.
///
/// # Errors
/// As [`scan`].
pub(crate) fn scan_whole_chunks(path: &Path, limits: &Limits, visit: Visit<'_>) -> Result<Ending, RecordingError> {
    scan_with(LinearReaderOptions::default().with_prevalidate_chunk_crcs(true), path, limits, visit)
}

fn scan_with(
    options: LinearReaderOptions,
    path: &Path,
    limits: &Limits,
    visit: Visit<'_>,
) -> Result<Ending, RecordingError> {
    let io = |source| RecordingError::Io { path: path.to_path_buf(), source };
    let mut file = File::open(path).map_err(io)?;
    if file.metadata().map_err(io)?.len() == 0 {
        return Err(RecordingError::Empty { path: path.to_path_buf() });
    }
    let mut magic = [0; mcap::MAGIC.len()];
    if file.read_exact(&mut magic).is_err() || magic != mcap::MAGIC {
        return Err(RecordingError::NotMcap { path: path.to_path_buf() });
    }
    chunks::check(&file, limits)?;
    file.seek(SeekFrom::Start(mcap::MAGIC.len() as u64)).map_err(io)?;
    let options = options.with_skip_start_magic(true).with_record_length_limit(limits.chunk_bytes);
    let mut reader = LinearReader::new_with_options(options);
    let mut records = 0;
    loop {
        match next_event(&mut reader) {
            None => return Ok(Ending::Whole),
            Some(Ok(LinearReadEvent::ReadRequest(_))) => {
                // How much is asked for may come from a false length, so the buffer grows with what is there.
                let read = file.read(reader.insert(READ_BYTES)).map_err(io)?;
                reader.notify_read(read);
            }
            Some(Ok(LinearReadEvent::Record { data, opcode })) => {
                records += 1;
                check(records, data.len(), limits)?;
                if let Some(record) = record::parse(opcode, data)? {
                    check_names(&record, limits)?;
                    visit(record)?;
                }
            }
            // Other closing bytes than the magic are a cut too: all records have been read by then.
            Some(Err(McapError::UnexpectedEof | McapError::BadMagic)) => return Ok(Ending::Cut),
            Some(Err(error)) => return Err(damaged(&error, limits)),
        }
    }
}

/// Holds a record's number and length against the limits.
fn check(records: u64, bytes: usize, limits: &Limits) -> Result<(), RecordingError> {
    let too_large = |problem| Err(RecordingError::TooLarge { problem });
    if records > limits.records {
        return too_large(format!("the file has more than {} records; split the recording", limits.records));
    }
    if bytes > limits.record_bytes {
        return too_large(format!(
            "a record has {bytes} bytes and may have {}; record smaller messages",
            limits.record_bytes
        ));
    }
    Ok(())
}

/// Names end up in reports, messages and logs.
fn check_names(record: &Record<'_>, limits: &Limits) -> Result<(), RecordingError> {
    let names = match record {
        Record::Schema { name, encoding, .. } => [("a schema's name", *name), ("a schema's encoding", *encoding)],
        Record::Channel { topic, encoding, .. } => [("a topic", *topic), ("a channel's encoding", *encoding)],
        Record::Header { profile } => [("the profile", *profile), ("", "")],
        Record::Metadata { name, .. } => [("the name of metadata", *name), ("", "")],
        Record::Message { .. } => return Ok(()),
    };
    for (what, name) in names {
        if name.len() > limits.name_bytes {
            let problem = format!(
                "{what} has {} bytes and may have {}; record it under a shorter name",
                name.len(),
                limits.name_bytes
            );
            return Err(RecordingError::TooLarge { problem });
        }
        if name.chars().any(char::is_control) {
            let problem = format!("{what} has control characters: {name:?}; record it under a plain name");
            return Err(RecordingError::Damaged { problem });
        }
    }
    Ok(())
}

/// The container crate still panics on some hostile bytes; those are damage like any other.
fn next_event(reader: &mut LinearReader) -> Option<Result<LinearReadEvent<'_>, McapError>> {
    let next = move || {
        let reader = reader;
        reader.next_event()
    };
    match catch_unwind(AssertUnwindSafe(next)) {
        Ok(event) => event,
        Err(_) => Some(Err(McapError::UnexpectedEoc)),
    }
}

fn damaged(error: &McapError, limits: &Limits) -> RecordingError {
    if matches!(error, McapError::RecordTooLarge { .. } | McapError::ChunkTooLarge(_)) {
        let problem = format!(
            "{error}; a chunk may have {} bytes, packed and unpacked, so the file is damaged or of another kind",
            limits.chunk_bytes
        );
        return RecordingError::TooLarge { problem };
    }
    RecordingError::Damaged { problem: format!("{error}; record or copy the file again") }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use std::collections::BTreeMap;

    use mcap::records::{MessageHeader, op};

    use super::*;

    fn scan_bytes(bytes: &[u8]) -> (Result<Ending, RecordingError>, usize) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        std::fs::write(&path, bytes).unwrap();
        let mut messages = 0;
        let ending = scan(&path, &Limits::default(), &mut |record| {
            messages += usize::from(matches!(record, Record::Message { .. }));
            Ok(())
        });
        (ending, messages)
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
    fn a_cut_at_any_byte_keeps_the_whole_messages_before_it() {
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
    fn says_what_is_no_mcap_file() {
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
}
