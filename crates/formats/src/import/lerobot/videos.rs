//! The video of one camera in one episode: its packets, in time with the steps.

use std::rc::Rc;

use gleaner_recording::CameraMessage;

use super::features::Picture;
use super::places::VideoPart;
use super::unfit;
use crate::import::mp4::{Film, Part};
use crate::import::recorder::Recorder;
use crate::problem::Problem;

/// The packets of one camera that are not written yet.
pub(super) struct Reel {
    film: Rc<Film>,
    part: Part,
    camera: usize,
    /// The next packet.
    next: usize,
    from: f64,
}

impl Reel {
    /// The reel of a part of a film.
    pub(super) fn new(
        film: Rc<Film>,
        picture: &Picture,
        part: &VideoPart,
        (steps, fps): (u64, f64),
    ) -> Result<Self, Problem> {
        if film.size != picture.size {
            let ((height, width), (wanted_height, wanted_width)) = (film.size, picture.size);
            let problem = format!(
                "the video has {height}×{width} pixels, and meta/info.json declares {wanted_height}×{wanted_width} for {}; \
                 correct its shape",
                picture.feature
            );
            return Err(unfit(&film.path, &problem));
        }
        let from = part.from;
        let part = film.part(from, usize::try_from(steps).unwrap_or(usize::MAX), fps)?;
        Ok(Self { next: *part.packets.start(), film, part, camera: picture.camera, from })
    }

    /// Writes the packets up to that of a step.
    pub(super) fn write_to(&mut self, step: u64, recorder: &mut Recorder) -> Result<(), Problem> {
        let Some(&last) = usize::try_from(step).ok().and_then(|step| self.part.of_steps.get(step)) else {
            return Ok(());
        };
        while self.next <= last {
            let stamp = match self.part.steps.get(&self.next) {
                // Times in the file are rounded to its clock.
                Some(&step) => recorder.step_stamp(u64::try_from(step).unwrap_or_default()),
                None => Recorder::stamp(self.film.time(self.next) - self.from),
            };
            let data = self.film.packet(self.next)?;
            let message = CameraMessage::Video { format: self.film.format(), data: &data };
            recorder.camera(self.camera, stamp, message)?;
            self.next += 1;
        }
        Ok(())
    }
}
