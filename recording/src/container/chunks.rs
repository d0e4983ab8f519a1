//! What the chunks of a file say they unpack to, looked at before any of them is unpacked.
//!
//! The container crate unpacks no more of a chunk than the chunk says, and believes what it says.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

use mcap::records::op;

use crate::error::RecordingError;
use crate::limits::Limits;

/// A record's kind and length.
const HEAD_BYTES: usize = 9;
/// Begin and end of a chunk's messages, before the length that it unpacks to.
const TIMES_BYTES: usize = 16;

/// Goes from record to record, chunks unopened. Where the lengths lead nowhere it stops: the reader will say so.
pub(super) fn check(file: &File, limits: &Limits) -> Result<(), RecordingError> {
    let mut file = BufReader::new(file);
    if file.seek(SeekFrom::Start(mcap::MAGIC.len() as u64)).is_err() {
        return Ok(());
    }
    while let Some((opcode, length)) = head(&mut file) {
        let mut rest = length;
        if opcode == op::CHUNK && length >= (TIMES_BYTES + 8) as u64 {
            let mut begin = [0; TIMES_BYTES + 8];
            if file.read_exact(&mut begin).is_err() {
                return Ok(());
            }
            rest -= begin.len() as u64;
            let unpacked = begin.last_chunk().copied().map(u64::from_le_bytes).unwrap_or_default();
            let most = limits.chunk_bytes as u64;
            if unpacked > most {
                let problem = format!(
                    "a chunk of {length} bytes unpacks to {unpacked} bytes and may unpack to {most}; the file is damaged, \
                     or was recorded in too large chunks"
                );
                return Err(RecordingError::TooLarge { problem });
            }
        }
        match i64::try_from(rest) {
            Ok(rest) if file.seek_relative(rest).is_ok() => {}
            _ => return Ok(()),
        }
    }
    Ok(())
}

fn head(file: &mut impl Read) -> Option<(u8, u64)> {
    let mut head = [0; HEAD_BYTES];
    file.read_exact(&mut head).ok()?;
    let [opcode, length @ ..] = head;
    Some((opcode, u64::from_le_bytes(length)))
}
