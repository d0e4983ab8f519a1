//! The streams of one mapping: each camera's topics and each field, on a timeline of their own.

use super::clocks::Clocks;
use crate::align::Timeline;
use crate::picture::Channel;
use crate::tracks::{FieldTrack, Tracks};
use crate::video::Reel;
use gleaner_core::{FieldSpec, TaskSpec};

/// A stream of which each step uses one message.
pub(crate) struct Stream<'a> {
    /// Topic or field, for findings.
    pub(crate) subject: String,
    pub(crate) topic: String,
    pub(crate) timeline: Timeline,
    pub(crate) source: Source<'a>,
}

/// The content of a stream's messages.
pub(crate) enum Source<'a> {
    Images {
        /// Index of the camera in the task.
        camera: usize,
        channel: Channel,
        /// The messages with a picture; `None` if each has its own.
        messages: Option<Vec<usize>>,
    },
    Field(&'a FieldTrack),
}

impl Stream<'_> {
    /// Whether this is the field of that name; a topic can have the same name.
    pub(crate) fn is_field(&self, name: &str) -> bool {
        matches!(self.source, Source::Field(_)) && self.subject == name
    }

    /// Index in the topic of the message at a position of the timeline.
    pub(crate) fn message(&self, at: usize) -> usize {
        let sample = self.timeline.order[at];
        match &self.source {
            Source::Images { messages, .. } => messages.as_ref().map_or(sample, |messages| messages[sample]),
            Source::Field(track) => track.messages[sample],
        }
    }

    /// Numbers of a field at a position of the timeline; none of an image.
    pub(crate) fn values(&self, at: usize) -> &[f32] {
        let sample = self.timeline.order[at];
        match self.source {
            Source::Images { .. } => &[],
            Source::Field(track) => &track.values[sample * track.size..(sample + 1) * track.size],
        }
    }
}

/// All streams of a mapping: images in the order of the cameras, then fields in the order of proprioception
/// and action. `None` if a field has no values.
pub(crate) fn streams<'a>(
    tracks: &'a Tracks,
    mapping: usize,
    spec: &TaskSpec,
    clocks: &Clocks,
) -> Option<Vec<Stream<'a>>> {
    let mut streams = Vec::new();
    let chosen = &spec.mappings[mapping];
    for (camera, wanted) in spec.cameras.iter().enumerate() {
        let source = chosen.cameras.iter().find(|source| source.camera == wanted.name)?;
        for (topic, channel) in [(Some(&source.color), Channel::Color), (source.depth.as_ref(), Channel::Depth)] {
            let Some(topic) = topic else { continue };
            let reel = tracks.tracks.get(topic).and_then(|track| track.reel.as_ref());
            let messages = reel.filter(|reel| reel.is_video() && channel == Channel::Color).map(Reel::pictures);
            streams.push(Stream {
                subject: topic.clone(),
                topic: topic.clone(),
                timeline: match &messages {
                    Some(messages) => clocks.timeline_of(tracks, topic, messages),
                    None => clocks.timeline(tracks, topic),
                },
                source: Source::Images { camera, channel, messages },
            });
        }
    }
    for field in spec.proprioception.iter().chain(&spec.action) {
        streams.push(field_stream(tracks, mapping, (spec, field), clocks)?);
    }
    Some(streams)
}

fn field_stream<'a>(
    tracks: &'a Tracks,
    mapping: usize,
    (spec, field): (&TaskSpec, &FieldSpec),
    clocks: &Clocks,
) -> Option<Stream<'a>> {
    let sources = &spec.mappings[mapping].fields;
    let at = sources.iter().position(|source| source.field == field.name)?;
    let topic = &sources[at].topic;
    let track = tracks.tracks.get(topic)?;
    let values = track.fields.iter().find(|values| (values.mapping, values.source) == (mapping, at))?;
    let times = values.messages.iter().map(|&message| clocks.time(track.stamps[message]));
    (!values.messages.is_empty()).then(|| Stream {
        subject: field.name.clone(),
        topic: topic.clone(),
        timeline: Timeline::new(times),
        source: Source::Field(values),
    })
}
