//! The channels of scores in a copy, in the dialect of its recording. Their topics belong to gleaner: no mapping reads them.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use prost::Message as _;

use super::StepScore;
use crate::error::RecordingError;
use crate::write::schema::{self, Quality};
use crate::write::{add_channel, timestamp};

/// All of a step's score as one protobuf message.
const QUALITY: &str = "/gleaner/quality";

/// One value of a step's score as a message of ROS 2.
struct Ros {
    topic: &'static str,
    schema: &'static str,
    definition: &'static str,
    /// The value in CDR; `None` for a step that has none.
    encode: fn(u32, &StepScore) -> Option<Vec<u8>>,
}

const ROS: [Ros; 6] = [
    Ros {
        topic: "/gleaner/q",
        schema: "std_msgs/msg/Float64",
        definition: "float64 data\n",
        encode: |_, score| Some(f64::from(score.q).to_le_bytes().into()),
    },
    Ros {
        topic: "/gleaner/w",
        schema: "std_msgs/msg/Float64",
        definition: "float64 data\n",
        encode: |_, score| Some(score.w.to_le_bytes().into()),
    },
    Ros {
        topic: "/gleaner/step",
        schema: "std_msgs/msg/UInt32",
        definition: "uint32 data\n",
        encode: |step, _| Some(step.to_le_bytes().into()),
    },
    Ros {
        topic: "/gleaner/kept",
        schema: "std_msgs/msg/Bool",
        definition: "bool data\n",
        encode: |_, score| Some(vec![score.kept.into()]),
    },
    Ros {
        topic: "/gleaner/match_episode",
        schema: "std_msgs/msg/String",
        definition: "string data\n",
        encode: |_, score| score.matched.as_ref().and_then(|(episode, _)| text(episode)),
    },
    Ros {
        topic: "/gleaner/match_step",
        schema: "std_msgs/msg/UInt32",
        definition: "uint32 data\n",
        encode: |_, score| score.matched.as_ref().map(|(_, step)| step.to_le_bytes().into()),
    },
];

/// A string in CDR: its length with the zero that ends it, its bytes, the zero.
fn text(text: &str) -> Option<Vec<u8>> {
    let length = u32::try_from(text.len()).ok()?.checked_add(1)?;
    Some([&length.to_le_bytes(), text.as_bytes(), &[0]].concat())
}

/// Little-endian CDR.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Whether a topic holds the scores of a copy.
pub(super) fn is_own(topic: &str) -> bool {
    topic == QUALITY || ROS.iter().any(|ros| ros.topic == topic)
}

/// The channels of the scores.
pub(super) enum ScoreChannels {
    Protobuf(u16),
    Ros([u16; ROS.len()]),
}

impl ScoreChannels {
    pub(super) fn new<W: Write + Seek>(writer: &mut mcap::Writer<W>, ros: bool) -> Result<Self, RecordingError> {
        if !ros {
            return add_channel(writer, QUALITY, &schema::quality()).map(Self::Protobuf);
        }
        let mut channels = [0; ROS.len()];
        for (channel, Ros { topic, schema, definition, .. }) in channels.iter_mut().zip(&ROS) {
            let schema = writer.add_schema(schema, "ros2msg", definition.as_bytes()).map_err(RecordingError::Write)?;
            *channel = writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).map_err(RecordingError::Write)?;
        }
        Ok(Self::Ros(channels))
    }

    /// Writes a step's score with the times of its message of the clock.
    pub(super) fn write<W: Write + Seek>(
        &self,
        writer: &mut mcap::Writer<W>,
        clock: MessageHeader,
        (stamp, step): (i64, usize),
        score: &StepScore,
    ) -> Result<(), RecordingError> {
        // An episode has at most ten million steps.
        let step = u32::try_from(step).unwrap_or(u32::MAX);
        let mut write = |channel_id, bytes: &[u8]| {
            let header = MessageHeader { channel_id, ..clock };
            writer.write_to_known_channel(&header, bytes).map_err(RecordingError::Write)
        };
        match self {
            Self::Protobuf(channel) => {
                let StepScore { q, w, kept, ref matched } = *score;
                let (match_episode, match_step) = matched.clone().unwrap_or_default();
                let timestamp = Some(timestamp(stamp));
                let quality = Quality { timestamp, step, q, w, kept, match_episode, match_step };
                write(*channel, &quality.encode_to_vec())
            }
            Self::Ros(channels) => channels.iter().zip(&ROS).try_for_each(|(channel, ros)| {
                let Some(value) = (ros.encode)(step, score) else { return Ok(()) };
                write(*channel, &[&ENCAPSULATION, value.as_slice()].concat())
            }),
        }
    }
}
