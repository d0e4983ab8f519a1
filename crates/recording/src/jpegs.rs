//! The JPEG files that a recording has for its steps, unchanged, so that an export copies them without a second loss.
//!
//! Only pictures that a step shows as they are count: those of its size and in color. This module decodes no pixels.

use std::collections::HashMap;
use std::fs::File;
use std::ops::Range;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

use crate::container::{Record, scan};
use crate::error::RecordingError;
use crate::image::is_color_jpeg;
use crate::limits::Limits;
use crate::picture::{Channel, data, layout};
use crate::plan::ImageStream;
use crate::planner::plan;
use gleaner_core::TaskSpec;

/// The JPEG files of some steps of a recording. They are in a file, so that memory does not grow with the recording.
#[derive(Debug)]
pub struct StepJpegs {
    file: File,
    path: PathBuf,
    /// Offset and length in the file, by camera and step.
    places: HashMap<(usize, usize), (u64, usize)>,
}

impl StepJpegs {
    /// Reads the recording and keeps the JPEG files of these steps in `file`, which is empty at first.
    ///
    /// # Errors
    /// Like [`crate::read_episode`].
    pub fn read(path: &Path, spec: &TaskSpec, steps: &Range<usize>, file: File) -> Result<Self, RecordingError> {
        let plan = plan(path, spec, &Limits::ADMITTED)?;
        let mut jpegs = Self { file, path: path.to_owned(), places: HashMap::new() };
        let colors: Vec<Color<'_>> = plan.images.iter().filter_map(|stream| Color::new(stream, spec, steps)).collect();
        if colors.is_empty() {
            return Ok(jpegs);
        }
        let (mut channels, mut end) = (plan.channels, 0);
        scan(path, &Limits::ADMITTED, &mut |record| {
            let Record::Message { header, data: bytes } = record else { return Ok(()) };
            let Some((topic, at, decoder)) = channels.next(header.channel_id) else { return Ok(()) };
            let Ok(decoder) = decoder.as_ref() else { return Ok(()) };
            for color in colors.iter().filter(|color| color.topic == topic) {
                let Some(shown) = color.steps.get(&at) else { continue };
                let Ok(message) = decoder.decode(bytes) else { continue };
                let Ok(picture) = data(&message) else { continue };
                if layout(&message).is_some() || !is_color_jpeg(&picture, color.size) {
                    continue;
                }
                jpegs.file.write_all_at(&picture, end).map_err(jpegs.fault())?;
                jpegs.places.extend(shown.iter().map(|&step| ((color.camera, step), (end, picture.len()))));
                end += u64::try_from(picture.len()).unwrap_or(u64::MAX);
            }
            Ok(())
        })?;
        Ok(jpegs)
    }

    /// The file that a step shows of a camera, both by index; `None` if its picture is not such a file.
    ///
    /// # Errors
    /// [`RecordingError::Io`].
    pub fn get(&self, camera: usize, step: usize) -> Result<Option<Vec<u8>>, RecordingError> {
        let Some(&(offset, length)) = self.places.get(&(camera, step)) else { return Ok(None) };
        let mut bytes = vec![0; length];
        self.file.read_exact_at(&mut bytes, offset).map_err(self.fault())?;
        Ok(Some(bytes))
    }

    fn fault(&self) -> impl Fn(std::io::Error) -> RecordingError + use<> {
        let path = self.path.clone();
        move |source| RecordingError::Io { path: path.clone(), source }
    }
}

/// A camera's color topic.
struct Color<'a> {
    topic: &'a str,
    camera: usize,
    size: (u32, u32),
    /// The steps that show each message.
    steps: HashMap<usize, Vec<usize>>,
}

impl<'a> Color<'a> {
    fn new(stream: &'a ImageStream, spec: &TaskSpec, wanted: &Range<usize>) -> Option<Self> {
        if stream.channel != Channel::Color || stream.video {
            return None;
        }
        let mut steps: HashMap<usize, Vec<usize>> = HashMap::new();
        for (step, &message) in stream.picks.iter().enumerate().filter(|(step, _)| wanted.contains(step)) {
            steps.entry(message).or_default().push(step);
        }
        let size = spec.cameras.get(stream.camera)?.sizes().step();
        Some(Self { topic: &stream.topic, camera: stream.camera, size, steps })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::write::tests::{written, written_arm};
    use crate::{PixelFormat, decode_color, read_episode};

    #[test]
    fn pictures_of_the_size_of_a_step_are_given_as_they_were_recorded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        std::fs::write(&path, written(6)).unwrap();
        let mut spec = written_arm();
        let jpegs = StepJpegs::read(&path, &spec, &(2..5), tempfile::tempfile().unwrap()).unwrap();
        let episode = read_episode(&path, &spec).unwrap().episode;
        let color = Channel::Color.bytes(&spec.cameras[0]);
        for (step, frame) in episode.frames().as_ref().chunks_exact(color / 3 * 5).enumerate() {
            let jpeg = jpegs.get(0, step).unwrap();
            assert_eq!(jpeg.is_some(), (2..5).contains(&step), "step {step}");
            if let Some(jpeg) = jpeg {
                let pixels = decode_color(&jpeg, PixelFormat::Jpeg, &spec.cameras[0].sizes()).unwrap();
                assert!(pixels == frame[..color], "step {step}");
            }
        }
        // A step that shows them smaller has no such files.
        spec.cameras[0].recorded = Some(gleaner_core::RecordedSize { height: 8, width: 16, crop: None });
        (spec.cameras[0].height, spec.cameras[0].width) = (4, 8);
        let jpegs = StepJpegs::read(&path, &spec, &(0..6), tempfile::tempfile().unwrap()).unwrap();
        assert_eq!(jpegs.get(0, 3).unwrap(), None);
    }
}
