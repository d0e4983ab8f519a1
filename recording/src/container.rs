//! The MCAP container: a file's records in order, with every length checked.
//!
//! Records are read one at a time, so memory follows the largest record, not the file. The bodies of the
//! few records that matter are parsed here, because the container crate reserves memory for a string
//! before it knows that the string is there. Knows nothing of dialects or tasks.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use mcap::McapError;
use mcap::records::{MessageHeader, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::error::RecordingError;

/// Largest single record; images and attachments are far below.
const MAX_RECORD_BYTES: usize = 256 << 20;
/// Bytes asked of the file at once.
const READ_BYTES: usize = 256 << 10;

/// A record that matters here.
#[derive(Debug)]
pub(crate) enum Record<'a> {
    Header {
        profile: &'a str,
    },
    Schema {
        id: u16,
        name: &'a str,
        encoding: &'a str,
        data: &'a [u8],
    },
    Channel {
        id: u16,
        schema_id: u16,
        topic: &'a str,
        encoding: &'a str,
        metadata: BTreeMap<String, String>,
    },
    Message {
        header: MessageHeader,
        data: &'a [u8],
    },
    Metadata {
        name: &'a str,
        values: BTreeMap<String, String>,
    },
}

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
    let io = |source| RecordingError::Io {
        path: path.to_path_buf(),
        source,
    };
    let mut file = File::open(path).map_err(io)?;
    if file.metadata().map_err(io)?.len() == 0 {
        return Err(RecordingError::Empty {
            path: path.to_path_buf(),
        });
    }
    let mut magic = [0; mcap::MAGIC.len()];
    if file.read_exact(&mut magic).is_err() || magic != mcap::MAGIC {
        return Err(RecordingError::NotMcap {
            path: path.to_path_buf(),
        });
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
                if let Some(record) = parse(opcode, data)? {
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
    match error {
        McapError::RecordTooLarge { .. } | McapError::ChunkTooLarge(_) => {
            RecordingError::TooLarge {
                problem: format!(
                    "{error}; a record may have {} MiB, so the file is damaged or not meant for this",
                    MAX_RECORD_BYTES >> 20
                ),
            }
        }
        other => RecordingError::Damaged {
            problem: format!("{other}; record or copy the file again"),
        },
    }
}

fn parse(opcode: u8, body: &[u8]) -> Result<Option<Record<'_>>, RecordingError> {
    let mut fields = Fields { rest: body };
    let record = match opcode {
        op::HEADER => fields.text().map(|profile| Record::Header { profile }),
        op::SCHEMA => fields.schema(),
        op::CHANNEL => fields.channel(),
        op::MESSAGE => fields.message(),
        op::METADATA => fields.metadata(),
        _ => return Ok(None),
    };
    record.map(Some).ok_or_else(|| RecordingError::Damaged {
        problem: format!(
            "a record of kind {opcode:#04x} does not fit its length; record or copy the file again"
        ),
    })
}

/// The fields of a record's body, read from the front; `None` once they do not fit.
struct Fields<'a> {
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.rest.split_first_chunk()?;
        self.rest = rest;
        Some(*head)
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(u32::from_le_bytes(self.array()?)).ok()?;
        let (head, rest) = self.rest.split_at_checked(length)?;
        self.rest = rest;
        Some(head)
    }

    fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.bytes()?).ok()
    }

    fn map(&mut self) -> Option<BTreeMap<String, String>> {
        let mut inner = Fields {
            rest: self.bytes()?,
        };
        let mut map = BTreeMap::new();
        while !inner.rest.is_empty() {
            map.insert(inner.text()?.to_owned(), inner.text()?.to_owned());
        }
        Some(map)
    }

    fn schema(&mut self) -> Option<Record<'a>> {
        Some(Record::Schema {
            id: self.u16()?,
            name: self.text()?,
            encoding: self.text()?,
            data: self.bytes()?,
        })
    }

    fn channel(&mut self) -> Option<Record<'a>> {
        Some(Record::Channel {
            id: self.u16()?,
            schema_id: self.u16()?,
            topic: self.text()?,
            encoding: self.text()?,
            metadata: self.map()?,
        })
    }

    fn message(&mut self) -> Option<Record<'a>> {
        let header = MessageHeader {
            channel_id: self.u16()?,
            sequence: u32::from_le_bytes(self.array()?),
            log_time: self.u64()?,
            publish_time: self.u64()?,
        };
        Some(Record::Message {
            header,
            data: self.rest,
        })
    }

    fn metadata(&mut self) -> Option<Record<'a>> {
        Some(Record::Metadata {
            name: self.text()?,
            values: self.map()?,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

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
        let channel = writer
            .add_channel(0, "/x", "json", &BTreeMap::new())
            .unwrap();
        for i in 0..10u32 {
            let time = u64::from(i);
            let header = MessageHeader {
                channel_id: channel,
                sequence: i,
                log_time: time,
                publish_time: time,
            };
            writer
                .write_to_known_channel(&header, b"{\"a\":1}")
                .unwrap();
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
        assert!(matches!(
            scan_bytes(b"").0,
            Err(RecordingError::Empty { .. })
        ));
        assert!(matches!(
            scan_bytes(b"PK\x03\x04 a zip file, say").0,
            Err(RecordingError::NotMcap { .. })
        ));
    }

    #[test]
    fn a_changed_byte_in_a_chunk_is_damage() {
        let mut bytes = ten_messages(mcap::WriteOptions::new().compression(None));
        let at = bytes
            .windows(7)
            .position(|window| window == b"{\"a\":1}")
            .unwrap();
        bytes[at + 5] = b'2';
        assert!(matches!(
            scan_bytes(&bytes).0,
            Err(RecordingError::Damaged { .. })
        ));
    }

    #[test]
    fn a_string_longer_than_its_record_is_damage() {
        let mut bytes = mcap::MAGIC.to_vec();
        bytes.extend([
            op::SCHEMA,
            8,
            0,
            0,
            0,
            0,
            0,
            0,
            0,
            1,
            0,
            0xff,
            0xff,
            0xff,
            0xff,
            b'a',
            b'b',
        ]);
        assert!(matches!(
            scan_bytes(&bytes).0,
            Err(RecordingError::Damaged { .. })
        ));
    }
}
