//! One chunk: its header, and the records that it unpacks to.
//!
//! The `mcap` crate unpacks no more of a chunk than its header states, so that size is compared with the limits first. The
//! crate still panics on some hostile bytes; such a panic is caught here and counts as damage.

use std::panic::{AssertUnwindSafe, catch_unwind};

use mcap::McapError;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::frames::{Frame, Frames, HEAD_BYTES, READ_BYTES};
use super::index::ChunkHead;
use crate::error::RecordingError;
use crate::limits::Limits;

/// Receives a record of a chunk: whether the chunk has a checksum, kind, body, and where it begins in the unpacked chunk.
type Visit<'a> = &'a mut dyn FnMut(bool, u8, &[u8], u64) -> Result<(), RecordingError>;

/// Visits the records of a chunk and returns its header; `None` if the file ends within the chunk. With `whole`, no
/// record is visited before the chunk's checksum has been compared.
pub(super) fn read(
    frames: &mut Frames,
    frame: &Frame,
    limits: &Limits,
    whole: bool,
    visit: Visit<'_>,
) -> Result<Option<ChunkHead>, RecordingError> {
    let Some((head, bytes)) = header(frames, frame)? else { return Ok(None) };
    let most = limits.chunk_bytes as u64;
    if head.uncompressed_size > most {
        let problem = format!(
            "a chunk of {} bytes unpacks to {} bytes and may unpack to {most}; the file is damaged, or was recorded in \
             too large chunks",
            frame.length, head.uncompressed_size
        );
        return Err(RecordingError::TooLarge { problem });
    }
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_validate_chunk_crcs(true)
        .with_prevalidate_chunk_crcs(whole)
        .with_record_length_limit(limits.chunk_bytes);
    let mut reader = LinearReader::new_with_options(options);
    for part in [&frame.head[..], &bytes] {
        reader.insert(part.len()).copy_from_slice(part);
        reader.notify_read(part.len());
    }
    let (mut rest, mut unpacked) = (frame.length.saturating_sub(bytes.len() as u64), 0);
    loop {
        match next_event(&mut reader) {
            None => return Ok(Some(head)),
            Some(Ok(LinearReadEvent::ReadRequest(_))) => {
                let most = usize::try_from(rest).unwrap_or(usize::MAX).min(READ_BYTES);
                let count = frames.read(reader.insert(most))?;
                if count == 0 && rest > 0 {
                    return Ok(None);
                }
                rest = rest.saturating_sub(count as u64);
                reader.notify_read(count);
            }
            Some(Ok(LinearReadEvent::Record { data, opcode })) => {
                visit(head.checksum != 0, opcode, data, unpacked)?;
                unpacked += (HEAD_BYTES + data.len()) as u64;
            }
            Some(Err(McapError::UnexpectedEof)) => {
                return Err(damaged("the records of a chunk do not fit its length"));
            }
            Some(Err(error @ (McapError::RecordTooLarge { .. } | McapError::ChunkTooLarge(_)))) => {
                let problem = format!(
                    "{error}; a chunk may have {most} bytes, packed and unpacked, so the file is damaged or of another \
                     kind"
                );
                return Err(RecordingError::TooLarge { problem });
            }
            Some(Err(error)) => return Err(damaged(&error.to_string())),
        }
    }
}

/// The chunk's header, parsed and as it is in the file.
fn header(frames: &mut Frames, frame: &Frame) -> Result<Option<(ChunkHead, Vec<u8>)>, RecordingError> {
    let short = || damaged("the header of a chunk does not fit the chunk's length");
    let (mut bytes, mut name) = (Vec::new(), Vec::new());
    if frame.length < ChunkHead::FIXED_BYTES + 8 {
        return Err(short());
    }
    if !frames.body(ChunkHead::FIXED_BYTES, &mut bytes)? {
        return Ok(None);
    }
    let rest = ChunkHead::name_bytes(&bytes).saturating_add(8);
    if rest > frame.length - ChunkHead::FIXED_BYTES {
        return Err(short());
    }
    if !frames.body(rest, &mut name)? {
        return Ok(None);
    }
    bytes.append(&mut name);
    let head = ChunkHead::parse(&bytes).ok_or_else(|| damaged("the compression of a chunk has no name in UTF-8"))?;
    Ok(Some((head, bytes)))
}

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

fn damaged(problem: &str) -> RecordingError {
    RecordingError::Damaged { problem: format!("{problem}; record or copy the file again") }
}
