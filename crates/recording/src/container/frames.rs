//! The records of a file in order, chunks unopened: where each one begins, its kind and length, and the checksum of
//! the bytes so far.
//!
//! Lengths are claims: a buffer grows with the bytes that are there.

use std::fs::File;
use std::io::{BufReader, Read, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use crc32fast::Hasher;

use crate::error::RecordingError;

/// Bytes requested from the file at once.
pub(super) const READ_BYTES: usize = 256 << 10;
/// Bytes of a record's kind and length.
pub(super) const HEAD_BYTES: usize = 9;

/// The bytes of an MCAP file between its magic bytes.
pub(super) struct Frames {
    path: PathBuf,
    file: BufReader<File>,
    /// Bytes of the file.
    pub(super) size: u64,
    /// Bytes read so far.
    pub(super) offset: u64,
    checksum: Hasher,
}

/// One record whose body is not read yet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) opcode: u8,
    /// Bytes of the body.
    pub(super) length: u64,
    /// The offset of the record in the file.
    pub(super) offset: u64,
    pub(super) head: [u8; HEAD_BYTES],
}

impl Frames {
    /// Opens a file and checks its magic bytes.
    pub(super) fn open(path: &Path) -> Result<Self, RecordingError> {
        let io = |source| RecordingError::Io { path: path.to_path_buf(), source };
        let file = File::open(path).map_err(io)?;
        let size = file.metadata().map_err(io)?.len();
        if size == 0 {
            return Err(RecordingError::Empty { path: path.to_path_buf() });
        }
        let file = BufReader::with_capacity(READ_BYTES, file);
        let mut frames = Self { path: path.to_path_buf(), file, size, offset: 0, checksum: Hasher::new() };
        if !frames.magic()? {
            return Err(RecordingError::NotMcap { path: path.to_path_buf() });
        }
        Ok(frames)
    }

    /// Whether the next bytes are the magic bytes that open and close a file.
    pub(super) fn magic(&mut self) -> Result<bool, RecordingError> {
        let mut magic = Vec::new();
        Ok(self.body(mcap::MAGIC.len() as u64, &mut magic)? && magic == mcap::MAGIC)
    }

    /// The offset of the first record.
    pub(super) fn begin() -> u64 {
        mcap::MAGIC.len() as u64
    }

    /// Continues at another offset, with a new checksum.
    pub(super) fn seek(&mut self, offset: u64) -> Result<(), RecordingError> {
        self.file.seek(SeekFrom::Start(offset)).map_err(|source| self.io(source))?;
        (self.offset, self.checksum) = (offset, Hasher::new());
        Ok(())
    }

    /// The next record; `None` where the file ends. [`Frames::include`] adds its head to the checksum.
    pub(super) fn next(&mut self) -> Result<Option<Frame>, RecordingError> {
        let offset = self.offset;
        let mut head = Vec::with_capacity(HEAD_BYTES);
        let read = (&mut self.file).take(HEAD_BYTES as u64).read_to_end(&mut head);
        self.offset += read.map_err(|source| self.io(source))? as u64;
        let Ok(head) = <[u8; HEAD_BYTES]>::try_from(head) else { return Ok(None) };
        let [opcode, length @ ..] = head;
        Ok(Some(Frame { opcode, length: u64::from_le_bytes(length), offset, head }))
    }

    /// Adds a record's head to the checksum.
    pub(super) fn include(&mut self, frame: &Frame) {
        self.checksum.update(&frame.head);
    }

    /// Returns the checksum so far and resets it.
    pub(super) fn checksum(&mut self) -> u32 {
        std::mem::take(&mut self.checksum).finalize()
    }

    /// Reads some bytes of a body; 0 where the file ends.
    pub(super) fn read(&mut self, buffer: &mut [u8]) -> Result<usize, RecordingError> {
        let count = self.file.read(buffer).map_err(|source| self.io(source))?;
        self.checksum.update(buffer.get(..count).unwrap_or_default());
        self.offset += count as u64;
        Ok(count)
    }

    /// Reads `length` bytes; false if the file has fewer.
    pub(super) fn body(&mut self, length: u64, buffer: &mut Vec<u8>) -> Result<bool, RecordingError> {
        buffer.clear();
        let read = (&mut self.file).take(length).read_to_end(buffer);
        let count = read.map_err(|source| self.io(source))? as u64;
        self.checksum.update(buffer);
        self.offset += count;
        Ok(count == length)
    }

    /// Skips `length` bytes; false if the file has fewer.
    pub(super) fn skip(&mut self, length: u64) -> Result<bool, RecordingError> {
        let (mut rest, mut buffer) = (length, [0; 8192]);
        while rest > 0 {
            let most = usize::try_from(rest).unwrap_or(usize::MAX).min(buffer.len());
            let count = self.read(buffer.get_mut(..most).unwrap_or_default())?;
            if count == 0 {
                return Ok(false);
            }
            rest -= count as u64;
        }
        Ok(true)
    }

    fn io(&self, source: std::io::Error) -> RecordingError {
        RecordingError::Io { path: self.path.clone(), source }
    }
}
