//! From a message to the pictures that it shows: the part of the second pass that several threads do.
//!
//! Must not depend on the cache, nor on what was shown before, apart from the decoders of video.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::channels::Readable;
use crate::picture;
use crate::plan::ImageStream;
use crate::video::{self, Packet, Shown, Video};
use crate::{RecordingError, TaskSpec};

/// What all threads read.
pub(super) struct Looking<'a> {
    pub(super) spec: &'a TaskSpec,
    pub(super) images: &'a [ImageStream],
    /// For each stream, its steps.
    pub(super) uses: &'a [Uses],
}

/// A message with images.
pub(super) struct Message<'a> {
    /// Index of the message in the topic.
    pub(super) at: usize,
    /// The streams of its topic.
    pub(super) streams: &'a [usize],
    pub(super) decoder: &'a Arc<Readable>,
    pub(super) data: &'a [u8],
}

/// The steps of a stream, by the message that they use.
pub(super) struct Uses(Vec<u32>);

/// The decoders of the streams of video. One set is of one thread.
#[derive(Default)]
pub(super) struct Films(BTreeMap<usize, Video>);

/// The pictures that a message shows, each with its stream.
pub(super) type Pictures = Vec<(usize, Shown)>;

impl Looking<'_> {
    /// Whether a topic with these streams is one of video.
    pub(super) fn is_video(&self, streams: &[usize]) -> bool {
        streams.iter().any(|&stream| self.images[stream].video)
    }

    /// The steps of a stream that use message `at` of its topic.
    pub(super) fn steps(&self, stream: usize, at: usize) -> &[u32] {
        self.uses[stream].of(&self.images[stream], at)
    }

    /// Whether decoding the message has an effect.
    pub(super) fn needs(&self, message: &Message<'_>) -> bool {
        let shows = |&stream: &usize| self.shows(stream, message.at);
        message.decoder.is_ok() && (self.is_video(message.streams) || message.streams.iter().any(shows))
    }

    fn shows(&self, stream: usize, at: usize) -> bool {
        !self.steps(stream, at).is_empty()
    }

    /// The pictures of a message, and those of earlier messages of video that come out with it.
    pub(super) fn look(&self, films: &mut Films, message: &Message<'_>) -> Pictures {
        // A message that can't be decoded was found in the first pass.
        let Ok(Ok(content)) = message.decoder.as_ref().as_ref().map(|decoder| decoder.decode(message.data)) else {
            return Vec::new();
        };
        if self.is_video(message.streams)
            && let Some(packet) = video::packet(&content)
        {
            return self.film(films, message, packet);
        }
        let shown = |&stream: &usize| {
            let image = &self.images[stream];
            let pixels = picture::decode(&content, image.channel, &self.spec.cameras[image.camera]);
            (stream, Shown { message: message.at, pixels, held: None })
        };
        message.streams.iter().filter(|&&stream| self.shows(stream, message.at)).map(shown).collect()
    }

    /// Decodes a message of video for each camera that has its topic.
    fn film(&self, films: &mut Films, message: &Message<'_>, packet: Result<Packet<'_>, RecordingError>) -> Pictures {
        let packet = packet.map_err(|error| error.to_string());
        let mut pictures = Vec::new();
        for &stream in message.streams.iter().filter(|&&stream| self.images[stream].video) {
            let camera = &self.spec.cameras[self.images[stream].camera];
            let used = |at| self.shows(stream, at);
            let shown = match &packet {
                Ok(packet) => films.0.entry(stream).or_default().push(message.at, packet, camera, &used),
                Err(problem) => {
                    let error = RecordingError::BrokenImage { problem: problem.clone() };
                    vec![Shown { message: message.at, pixels: Err(error), held: None }]
                }
            };
            pictures.extend(shown.into_iter().map(|shown| (stream, shown)));
        }
        pictures
    }

    /// Ends these streams of video: the pictures that their last messages show.
    pub(super) fn end(&self, films: &mut Films, streams: &[usize]) -> Pictures {
        let mut pictures = Vec::new();
        for &stream in streams {
            let Some(mut video) = films.0.remove(&stream) else { continue };
            let used = |at| self.shows(stream, at);
            let shown = video.end(&self.spec.cameras[self.images[stream].camera], &used);
            pictures.extend(shown.into_iter().map(|shown| (stream, shown)));
        }
        pictures
    }
}

impl Uses {
    pub(super) fn new(image: &ImageStream) -> Self {
        let picks = &image.picks;
        // A topic has at most ten million messages, and so an episode has as many steps.
        let mut steps: Vec<u32> = (0..u32::try_from(picks.len()).unwrap_or(u32::MAX)).collect();
        steps.sort_by_key(|&step| picks[step as usize]);
        Self(steps)
    }

    /// The steps that use message `at` of the topic of this image.
    fn of(&self, image: &ImageStream, at: usize) -> &[u32] {
        let begin = self.0.partition_point(|&step| image.picks[step as usize] < at);
        let count = self.0[begin..].partition_point(|&step| image.picks[step as usize] == at);
        &self.0[begin..begin + count]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Channel;

    #[test]
    fn each_message_has_its_steps() {
        let picks = vec![4, 2, 2, 9, 4];
        let image = ImageStream { topic: "/front".into(), camera: 0, channel: Channel::Color, video: false, picks };
        let uses = Uses::new(&image);
        let found: Vec<&[u32]> = [0, 2, 3, 4, 5, 9].map(|at| uses.of(&image, at)).into();
        let expected: [&[u32]; 6] = [&[], &[1, 2], &[], &[0, 4], &[], &[3]];
        assert_eq!(found, expected);
    }
}
