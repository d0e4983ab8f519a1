//! The MCAP container: a file's records in order, with every length checked.
//!
//! Records are read one at a time, so memory follows the largest record, not the file. Knows nothing of
//! dialects or tasks.

mod record;

use std::fs::File;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use mcap::McapError;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::error::RecordingError;

pub(crate) use record::Record;

/// Largest single record; images and attachments are far below.
const MAX_RECORD_BYTES: usize = 256 << 20;
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

/// Hands every record of the file to `visit`, in the file's order.
///
/// # Errors
/// Those of `visit`; [`RecordingError::Io`], `Empty`, `NotMcap`, `TooLarge` and `Damaged`.
pub(crate) fn scan(
    path: &Path,
    visit: &mut dyn FnMut(Record<'_>) -> Result<(), RecordingError>,
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
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_validate_chunk_crcs(true)
        .with_record_length_limit(MAX_RECORD_BYTES);
    let mut reader = LinearReader::new_with_options(options);
    loop {
        match next_event(&mut reader) {
            None => return Ok(Ending::Whole),
            Some(Ok(LinearReadEvent::ReadRequest(_))) => {
                // How much is asked for may come from a false length, so the buffer grows with what is there.
                let read = file.read(reader.insert(READ_BYTES)).map_err(io)?;
                reader.notify_read(read);
            }
            Some(Ok(LinearReadEvent::Record { data, opcode })) => {
                if let Some(record) = record::parse(opcode, data)? {
                    visit(record)?;
                }
            }
            // Other closing bytes than the magic are a cut too: all records have been read by then.
            Some(Err(McapError::UnexpectedEof | McapError::BadMagic)) => return Ok(Ending::Cut),
            Some(Err(error)) => return Err(damaged(&error)),
        }
    }
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

fn damaged(error: &McapError) -> RecordingError {
    if matches!(error, McapError::RecordTooLarge { .. } | McapError::ChunkTooLarge(_)) {
        let limit = MAX_RECORD_BYTES >> 20;
        let problem = format!("{error}; a record may have {limit} MiB, so the file is damaged or of another kind");
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
        let ending = scan(&path, &mut |record| {
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
