//! Which messages of a camera's topic have a picture, and from where each is decoded.

use std::collections::BTreeSet;

use gleaner_video::{Glance, Part, VideoError, glance};

use super::packet;
use crate::dialect::Value;

/// The messages of a camera's topic, from their headers alone.
#[derive(Debug, Default)]
pub(crate) struct Reel {
    /// For each message with a picture, the message at which its decoding begins.
    starts: Vec<Option<u32>>,
    /// Messages with parameter sets, on which later pictures may depend.
    parameters: Vec<usize>,
    /// The newest key frame, and the one before it.
    keys: [Option<u32>; 2],
    video: bool,
    /// Why the first message that could not be read has no key frame.
    failure: Option<VideoError>,
}

impl Reel {
    /// Adds the next message of the topic; `None` for one that can't be read.
    pub(crate) fn push(&mut self, message: Option<&Value<'_>>) {
        let at = u32::try_from(self.starts.len()).ok();
        let start = match message.map(|message| packet(message)) {
            Some(Some(Ok(packet))) => {
                self.video = true;
                let held = glance(packet.codec, &packet.data).unwrap_or_else(|error| {
                    self.failure.get_or_insert(error);
                    // Its place in the stream is that of a damaged picture.
                    Glance { part: Part::Follows, pictures: 1, parameters: false }
                });
                self.place(at, held)
            }
            // A codec without a decoder is found when its picture is needed.
            Some(Some(Err(_))) => {
                self.video = true;
                at
            }
            Some(None) => at,
            None => None,
        };
        self.starts.push(start);
    }

    /// The message at which the decoding of this one begins.
    fn place(&mut self, at: Option<u32>, held: Glance) -> Option<u32> {
        if held.parameters {
            self.parameters.push(self.starts.len());
        }
        if held.part == Part::Key {
            self.keys = [at, self.keys[0]];
        }
        match held.part {
            Part::None => None,
            Part::Key | Part::Follows if held.pictures > 0 => self.keys[0],
            Part::Leading if held.pictures > 0 => self.keys[1],
            Part::Key | Part::Follows | Part::Leading => None,
        }
    }

    /// Whether some message is video.
    pub(crate) fn is_video(&self) -> bool {
        self.video
    }

    /// Why no message has a picture, if its bytes are the reason.
    pub(crate) fn failure(&self) -> Option<&VideoError> {
        self.failure.as_ref()
    }

    /// The messages with a picture.
    pub(crate) fn pictures(&self) -> Vec<usize> {
        let all = self.starts.iter().enumerate();
        all.filter_map(|(at, start)| start.is_some().then_some(at)).collect()
    }

    /// The messages that decoding these needs: from the key frame before the first to the last, and the earlier messages
    /// with parameter sets if that key frame has none.
    pub(crate) fn needed(&self, messages: &BTreeSet<usize>) -> BTreeSet<usize> {
        let starts = messages.iter().filter_map(|&at| self.starts.get(at).copied().flatten());
        let begin = starts.min().and_then(|start| usize::try_from(start).ok());
        let (Some(begin), Some(&last)) = (begin, messages.last()) else { return messages.clone() };
        // Sets may be spread over messages of their own. Earlier key frames are no harm, but pictures of H.265 that are
        // shown before the first key frame of a copy have no picture only if it is the first.
        let sets = if self.parameters.contains(&begin) { &[][..] } else { &self.parameters };
        sets.iter().copied().filter(|&at| at < begin).chain(begin..=last).collect()
    }
}
