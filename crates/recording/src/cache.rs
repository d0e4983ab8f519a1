//! The frame cache: a decoded episode as one file, of which any step is read without the others.
//!
//! Layout, all little-endian: a head (`layout.rs`), one row a step (stamp, proprioception, action, the place of each
//! image of the step, a checksum), then the pictures, each compressed without loss (`codec.rs`), alone or as its
//! difference to an earlier one that is, so that any picture is read with one other at most. A picture that several steps
//! use is there once. A cache is derived from a recording and can be made again at any time: each part has a checksum, so
//! that damage is found where it is read.

mod codec;
mod layout;
mod write;

use std::fs::File;
use std::ops::Range;
use std::os::unix::fs::FileExt as _;
use std::path::Path;
use std::sync::Arc;

use crate::error::RecordingError;
use crate::frames::{Picture, pictures};
use codec::{Unpacker, packed_bound};
use gleaner_core::TaskSpec;
use layout::{Head, Place, Row};

pub(crate) use write::{CacheWriter, Steps};

/// A frame cache whose head was checked. The file is opened for each read and held by none, so that any number of
/// episodes can be used at once.
#[derive(Clone, Debug)]
pub struct FrameCache {
    path: Arc<Path>,
    head: Head,
    pictures: Arc<[Picture]>,
}

/// A picture that others are differences to.
struct KeyPicture {
    place: Place,
    pixels: Vec<u8>,
}

/// The numbers of consecutive steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Numbers {
    /// Each step's stamp in nanoseconds.
    pub stamps: Vec<i64>,
    /// Steps × M values, row-major.
    pub proprioception: Vec<f32>,
    /// Steps × A values, row-major.
    pub action: Vec<f32>,
}

impl FrameCache {
    /// Checks the head and the length of a cache of this task. Reads find damage of other parts.
    ///
    /// # Errors
    /// [`RecordingError::Io`], or [`RecordingError::Cache`] if the file is no whole cache of this version and task.
    pub fn open(path: &Path, spec: &TaskSpec) -> Result<Self, RecordingError> {
        let file = File::open(path).map_err(io_error(path))?;
        let found = file.metadata().map_err(io_error(path))?.len();
        let mut bytes = vec![0; Head::BYTES.min(usize::try_from(found).unwrap_or(usize::MAX))];
        file.read_exact_at(&mut bytes, 0).map_err(io_error(path))?;
        let head = Head::parse(&bytes, spec).map_err(|problem| damaged(path, &problem))?;
        if found != head.file_bytes || head.row_at(head.steps).is_none_or(|end| end > found) {
            return Err(damaged(path, "its length is not that of its head"));
        }
        Ok(Self { path: path.into(), head, pictures: pictures(spec).into() })
    }

    /// Number of steps T.
    pub fn steps(&self) -> usize {
        self.head.steps
    }

    /// Bytes of the images of one step.
    pub fn frame_bytes(&self) -> usize {
        self.pictures.iter().map(|picture| picture.bytes).sum()
    }

    /// The numbers of these steps. Reads the disk.
    ///
    /// # Errors
    /// [`RecordingError::Io`]; [`RecordingError::Cache`] if the file is damaged; [`RecordingError::Step`] if the episode
    /// does not have the steps.
    pub fn numbers(&self, steps: Range<usize>) -> Result<Numbers, RecordingError> {
        let mut numbers = Numbers::default();
        let bytes = self.row_bytes(&self.open_for(&steps)?, &steps)?;
        for (step, bytes) in steps.zip(bytes.chunks_exact(self.head.row_bytes())) {
            let row = Row::numbers(&self.head, step, bytes, &mut numbers.proprioception, &mut numbers.action);
            numbers.stamps.push(row.ok_or_else(|| self.broken(step))?);
        }
        Ok(numbers)
    }

    /// The images of these steps, each step as [`FrameBytes`](crate::FrameBytes) describes. Reads the disk.
    ///
    /// # Errors
    /// Like [`FrameCache::numbers`].
    pub fn frames(&self, steps: Range<usize>) -> Result<Vec<u8>, RecordingError> {
        let mut frames = vec![0; steps.len().saturating_mul(self.frame_bytes())];
        self.read_frames(steps, &mut frames)?;
        Ok(frames)
    }

    /// Fills `frames` with the images of these steps, one step after the other; it must have their size.
    ///
    /// # Errors
    /// Like [`FrameCache::numbers`].
    pub fn read_frames(&self, steps: Range<usize>, frames: &mut [u8]) -> Result<(), RecordingError> {
        if self.pictures.is_empty() {
            return Ok(());
        }
        let file = self.open_for(&steps)?;
        let mut unpacker = Unpacker::new().map_err(io_error(&self.path))?;
        let mut keys: Vec<Option<KeyPicture>> = self.pictures.iter().map(|_| None).collect();
        let mut before: Option<(Vec<Place>, &mut [u8])> = None;
        let rows = self.rows(&file, steps)?;
        for (row, frame) in rows.into_iter().zip(frames.chunks_exact_mut(self.frame_bytes())) {
            for (stream, picture) in self.pictures.iter().enumerate() {
                let pixels = &mut frame[picture.offset..picture.offset + picture.bytes];
                let place = row.places[stream];
                match &before {
                    Some((places, frame)) if places[stream] == place => {
                        pixels.copy_from_slice(&frame[picture.offset..picture.offset + picture.bytes]);
                    }
                    Some(_) | None => {
                        self.picture(&file, place, (&mut unpacker, &mut keys[stream]), (picture, pixels))?;
                    }
                }
            }
            before = Some((row.places, frame));
        }
        Ok(())
    }

    fn open_for(&self, steps: &Range<usize>) -> Result<File, RecordingError> {
        if steps.end > self.head.steps {
            let problem = format!("is not in {}, which has {} steps", self.path.display(), self.head.steps);
            return Err(RecordingError::Step { step: steps.end as u64, problem });
        }
        File::open(&self.path).map_err(io_error(&self.path))
    }

    fn rows(&self, file: &File, steps: Range<usize>) -> Result<Vec<Row>, RecordingError> {
        let bytes = self.row_bytes(file, &steps)?;
        let row = |(step, bytes)| Row::parse(&self.head, step, bytes).ok_or_else(|| self.broken(step));
        steps.zip(bytes.chunks_exact(self.head.row_bytes())).map(row).collect()
    }

    fn row_bytes(&self, file: &File, steps: &Range<usize>) -> Result<Vec<u8>, RecordingError> {
        let cut = || damaged(&self.path, "it ends in the middle");
        let begin = self.head.row_at(steps.start).ok_or_else(cut)?;
        let mut bytes = vec![0; steps.len().saturating_mul(self.head.row_bytes())];
        self.read(file, &mut bytes, begin)?;
        Ok(bytes)
    }

    fn broken(&self, step: usize) -> RecordingError {
        damaged(&self.path, &format!("the checksum of step {step} is wrong"))
    }

    /// Fills the pixels of a picture. `key` is the last one of its stream that was packed alone.
    fn picture(
        &self,
        file: &File,
        place: Place,
        (unpacker, key): (&mut Unpacker, &mut Option<KeyPicture>),
        (picture, pixels): (&Picture, &mut [u8]),
    ) -> Result<(), RecordingError> {
        let fault = |problem: String| damaged(&self.path, &problem);
        let packed = self.packed(file, place, picture)?;
        let (of, packed) = Unpacker::key(&packed).map_err(fault)?;
        let Some(of) = of else {
            unpacker.alone(packed, picture.row_bytes, pixels).map_err(fault)?;
            *key = Some(KeyPicture { place, pixels: pixels.to_vec() });
            return Ok(());
        };
        let whole = match key.take().filter(|key| key.place == of) {
            Some(key) => key,
            None => {
                let packed = self.packed(file, of, picture)?;
                let (None, packed) = Unpacker::key(&packed).map_err(fault)? else {
                    return Err(fault("a picture is the difference to a difference".to_owned()));
                };
                let mut whole = vec![0; picture.bytes];
                unpacker.alone(packed, picture.row_bytes, &mut whole).map_err(fault)?;
                KeyPicture { place: of, pixels: whole }
            }
        };
        unpacker.difference(packed, &whole.pixels, pixels).map_err(fault)?;
        *key = Some(whole);
        Ok(())
    }

    fn packed(&self, file: &File, place: Place, picture: &Picture) -> Result<Vec<u8>, RecordingError> {
        if place.length as usize > packed_bound(picture.bytes) {
            return Err(damaged(&self.path, "a picture is larger than any of its size"));
        }
        if place.offset.checked_add(place.length.into()).is_none_or(|end| end > self.head.file_bytes) {
            return Err(damaged(&self.path, "a picture is outside of the file"));
        }
        let mut packed = vec![0; place.length as usize];
        self.read(file, &mut packed, place.offset)?;
        if crc32fast::hash(&packed) != place.crc {
            return Err(damaged(&self.path, &format!("the checksum of the picture at byte {} is wrong", place.offset)));
        }
        Ok(packed)
    }

    fn read(&self, file: &File, bytes: &mut [u8], offset: u64) -> Result<(), RecordingError> {
        file.read_exact_at(bytes, offset).map_err(|error| {
            if error.kind() == std::io::ErrorKind::UnexpectedEof {
                return damaged(&self.path, "it ends in the middle");
            }
            io_error(&self.path)(error)
        })
    }
}

fn damaged(path: &Path, problem: &str) -> RecordingError {
    RecordingError::Cache { problem: format!("{}: {problem}", path.display()) }
}

/// Wraps an error of a file, for `map_err`.
fn io_error(path: &Path) -> impl Fn(std::io::Error) -> RecordingError {
    move |source| RecordingError::Io { path: path.to_path_buf(), source }
}

#[cfg(test)]
mod tests;
