//! Writing a frame cache while its recording is read: pictures first, as they are decoded, then the rows.
//!
//! Memory follows the number of pictures by 16 bytes each, and not their size, apart from one picture of each stream.
//! Independent of recordings.

use std::fs::File;
use std::io::{BufWriter, Seek as _, SeekFrom, Write as _};
use std::path::Path;

use super::codec::{Key, Packer};
use super::io_error;
use super::layout::{Head, Place, Row};
use crate::error::RecordingError;
use crate::frames::{Episode, Picture, pictures};
use crate::whole_file::write_whole;
use gleaner_core::TaskSpec;

/// The numbers of all steps, and the picture of each step and stream.
pub(crate) struct Steps<'a> {
    pub(crate) stamps: &'a [i64],
    /// T×M and T×A, row-major.
    pub(crate) proprioception: &'a [f32],
    pub(crate) action: &'a [f32],
    /// For each stream and step, the picture's number in its stream from 1 on; 0 for none.
    pub(crate) shown: &'a [Vec<u32>],
}

/// A cache that is being written.
pub(crate) struct CacheWriter<'a> {
    path: &'a Path,
    out: BufWriter<File>,
    head: Head,
    forms: Vec<Picture>,
    /// Where the next picture goes.
    offset: u64,
    /// For each stream, its pictures so far.
    places: Vec<Vec<Place>>,
    /// For each stream, the picture that later ones are differences to.
    keys: Vec<Option<Key>>,
    packer: Packer,
}

impl<'a> CacheWriter<'a> {
    /// Begins a cache of a number of steps. `path` is for errors.
    ///
    /// # Errors
    /// [`RecordingError::Io`].
    pub(crate) fn begin(
        mut out: BufWriter<File>,
        path: &'a Path,
        spec: &TaskSpec,
        steps: usize,
    ) -> Result<Self, RecordingError> {
        let (head, forms) = (Head::new(spec, steps), pictures(spec));
        let too_long = || std::io::Error::from(std::io::ErrorKind::FileTooLarge);
        let offset = head.row_at(steps).ok_or_else(too_long).map_err(io_error(path))?;
        out.seek(SeekFrom::Start(offset)).map_err(io_error(path))?;
        let packer = Packer::new().map_err(io_error(path))?;
        let (places, keys) = (vec![Vec::new(); forms.len()], forms.iter().map(|_| None).collect());
        Ok(Self { path, out, head, places, keys, forms, offset, packer })
    }

    /// Packs and adds the next picture of a stream.
    ///
    /// # Errors
    /// [`RecordingError::Io`].
    pub(crate) fn picture(&mut self, stream: usize, pixels: &[u8]) -> Result<(), RecordingError> {
        let key = &mut self.keys[stream];
        let packed = self.packer.pack(pixels, self.forms[stream].row_bytes, key.as_mut());
        let packed = packed.map_err(io_error(self.path))?;
        self.out.write_all(packed.bytes).map_err(io_error(self.path))?;
        // A step's images have at most 1 GiB.
        let length = u32::try_from(packed.bytes.len()).unwrap_or(u32::MAX);
        let place = Place { offset: self.offset, length, crc: crc32fast::hash(packed.bytes) };
        if packed.is_key {
            *key = Some(Key::new(place, pixels));
        }
        self.places[stream].push(place);
        self.offset += u64::from(length);
        Ok(())
    }

    /// Writes the rows and the head, and returns the file.
    ///
    /// # Errors
    /// [`RecordingError::Io`].
    pub(crate) fn finish(mut self, steps: &Steps<'_>) -> Result<BufWriter<File>, RecordingError> {
        let Head { widths: [proprioception, action, _], .. } = self.head;
        self.head.file_bytes = self.offset;
        let mut bytes = self.head.to_bytes();
        self.out.seek(SeekFrom::Start(0)).map_err(io_error(self.path))?;
        for (step, stamp) in steps.stamps.iter().enumerate() {
            let place = |(places, shown): (&Vec<Place>, &Vec<u32>)| {
                let picture = (shown[step] as usize).checked_sub(1);
                picture.and_then(|picture| places.get(picture)).copied().unwrap_or_default()
            };
            let row = Row {
                stamp: *stamp,
                proprioception: steps.proprioception[step * proprioception..(step + 1) * proprioception].to_vec(),
                action: steps.action[step * action..(step + 1) * action].to_vec(),
                places: self.places.iter().zip(steps.shown).map(place).collect(),
            };
            row.write(step, &mut bytes);
            self.out.write_all(&bytes).map_err(io_error(self.path))?;
            bytes.clear();
        }
        self.out.write_all(&bytes).map_err(io_error(self.path))?;
        Ok(self.out)
    }
}

impl Episode {
    /// Writes the episode as a frame cache of its task. The file appears under its name only once it is whole.
    ///
    /// # Errors
    /// [`RecordingError::Io`].
    pub fn write_cache(&self, spec: &TaskSpec, path: &Path) -> Result<(), RecordingError> {
        let frames = self.frames();
        let forms = pictures(spec);
        let step_bytes = forms.iter().map(|form| form.bytes).sum::<usize>();
        write_whole(path, |out| {
            let mut writer = CacheWriter::begin(out, path, spec, self.steps())?;
            let mut shown = vec![Vec::new(); forms.len()];
            for (stream, form) in forms.iter().enumerate() {
                let image = |step: usize| &frames.as_ref()[step * step_bytes + form.offset..][..form.bytes];
                let mut number = 0;
                for step in 0..self.steps() {
                    if step == 0 || image(step) != image(step - 1) {
                        writer.picture(stream, image(step))?;
                        number += 1;
                    }
                    shown[stream].push(number);
                }
            }
            let (proprioception, action) = (&self.proprioception, &self.action);
            writer.finish(&Steps { stamps: &self.stamps, proprioception, action, shown: &shown })
        })
    }
}
