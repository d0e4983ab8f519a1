//! The pictures of one camera in one demonstration, as a dataset of the file.

use std::ops::Range;

use gleaner_core::TaskSpec;
use hdf5_pure::{DatasetBuilder, make_f32_type, make_u8_type};

use super::{DEFLATE, MOST_PICTURES, count};
use crate::export::Export;
use crate::piece::Piece;
use crate::problem::Problem;

/// The pictures of one camera: its colors, or its depth in metres.
pub(super) struct Pictures {
    /// The name of the dataset.
    pub(super) name: String,
    depth: bool,
    /// (height, width).
    size: (u32, u32),
    /// Their place among the bytes of a step's frames.
    place: Range<usize>,
}

/// The pictures that are written of each demonstration.
pub(super) fn pictures(task: &TaskSpec, depth: bool) -> Vec<Pictures> {
    let (mut all, mut offset) = (Vec::new(), 0);
    for camera in &task.cameras {
        let size = (camera.height, camera.width);
        let pixels = camera.height as usize * camera.width as usize;
        let color = offset..offset + 3 * pixels;
        let metres = color.end..color.end + if camera.depth { 2 * pixels } else { 0 };
        offset = metres.end;
        all.push(Pictures { name: format!("{}_image", camera.name), depth: false, size, place: color });
        if camera.depth && depth {
            all.push(Pictures { name: format!("{}_depth", camera.name), depth: true, size, place: metres });
        }
    }
    all
}

/// Refuses a demonstration whose pictures of one camera do not fit into memory, before the first one is read.
pub(super) fn check_lengths(pieces: &[Piece], task: &TaskSpec, depth: bool) -> Result<(), Problem> {
    let Some(most) = pictures(task, depth).into_iter().max_by_key(Pictures::bytes) else { return Ok(()) };
    let steps = MOST_PICTURES / most.bytes().max(1);
    let Some(long) = pieces.iter().find(|piece| piece.len() > steps) else { return Ok(()) };
    Err(Problem::Unfit(format!(
        "episode {} has {} steps in one piece, and a demonstration in robomimic's format at most {steps} with {}×{} pixels \
         ({} GiB of one camera, which are written at once); export with `--format lerobot` or `--format mcap`, or record \
         shorter episodes",
        long.episode().id,
        long.len(),
        most.size.0,
        most.size.1,
        MOST_PICTURES >> 30
    )))
}

impl Pictures {
    /// Bytes of one picture in the file.
    fn bytes(&self) -> usize {
        if self.depth { self.place.len() * 2 } else { self.place.len() }
    }

    /// The pictures of every step of a piece, as bytes of the file; `later` are those one step later, where the last one
    /// repeats.
    ///
    /// # Errors
    /// Those of reading the frames.
    pub(super) fn read<E: Export>(&self, export: &mut E, piece: usize, later: bool) -> Result<Vec<u8>, E::Error> {
        let steps = export.pieces()[piece].steps.clone();
        let mut values = Vec::with_capacity(steps.len() * self.bytes());
        for step in steps.clone() {
            let step = if later { (step + 1).min(steps.end - 1) } else { step };
            let frames = export.frames(piece, step)?;
            let own = frames.get(self.place.clone()).unwrap_or_default();
            if self.depth {
                let metres = |mm: &[u8; 2]| f32::from(u16::from_le_bytes(*mm)) / 1000.0;
                values.extend(own.as_chunks().0.iter().flat_map(|mm| metres(mm).to_le_bytes()));
            } else {
                values.extend_from_slice(own);
            }
        }
        Ok(values)
    }

    /// Sets the content of the dataset, which takes the bytes of this many steps without a copy.
    pub(super) fn describe(&self, dataset: &mut DatasetBuilder, steps: usize, values: Vec<u8>) {
        let (steps, height, width) = (count(steps), u64::from(self.size.0), u64::from(self.size.1));
        let (kind, channels) = if self.depth { (make_f32_type(), 1) } else { (make_u8_type(), 3) };
        let elements = steps * height * width * channels;
        dataset.with_raw_data(kind, values, elements).with_shape(&[steps, height, width, channels]);
        dataset.with_chunks(&[1, height, width, channels]);
        if self.depth {
            dataset.with_shuffle();
        }
        dataset.with_deflate(DEFLATE);
    }
}
