//! Event files of TensorBoard: records of protobuf messages, each with masked checksums.
//!
//! The messages are the part of `tensorflow/core/util/event.proto` and `summary.proto` that scalars need.

use std::io::{self, Write};

use crc::{CRC_32_ISCSI, Crc};
use prost::Message;

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);
/// The first event of a file names its version.
const VERSION: &str = "brain.Event:2";

#[derive(Clone, PartialEq, Message)]
struct Event {
    /// Seconds since 1970.
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(string, optional, tag = "3")]
    file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    summary: Option<Summary>,
}

#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Value>,
}

#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, tag = "2")]
    simple_value: f32,
}

/// One value of a curve.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Scalar {
    /// Name of the curve, such as `pretrain/loss`.
    pub(crate) tag: String,
    pub(crate) step: u64,
    pub(crate) value: f64,
    /// Seconds since 1970.
    pub(crate) wall_time: f64,
}

/// Writes an event file.
pub(crate) fn write(out: &mut impl Write, begun: f64, scalars: &[Scalar]) -> io::Result<()> {
    let version = Event { wall_time: begun, file_version: Some(VERSION.to_owned()), ..Event::default() };
    record(out, &version)?;
    for Scalar { tag, step, value, wall_time } in scalars {
        #[expect(clippy::cast_possible_truncation, reason = "the format has 32 bits")]
        let value = Value { tag: tag.clone(), simple_value: *value as f32 };
        let step = i64::try_from(*step).unwrap_or(i64::MAX);
        let summary = Some(Summary { value: vec![value] });
        record(out, &Event { wall_time: *wall_time, step, file_version: None, summary })?;
    }
    out.flush()
}

fn record(out: &mut impl Write, event: &Event) -> io::Result<()> {
    let body = event.encode_to_vec();
    let length = (body.len() as u64).to_le_bytes();
    out.write_all(&length)?;
    out.write_all(&masked(&length).to_le_bytes())?;
    out.write_all(&body)?;
    out.write_all(&masked(&body).to_le_bytes())
}

/// The checksum of data that may contain checksums itself.
fn masked(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_have_length_checksums_and_values() {
        let mut out = Vec::new();
        let scalar = Scalar { tag: "train/loss".into(), step: 7, value: 0.5, wall_time: 12.5 };
        write(&mut out, 10.0, &[scalar]).unwrap();
        let mut rest = out.as_slice();
        let mut events = Vec::new();
        while let Some((length, after)) = rest.split_first_chunk::<8>() {
            let size = usize::try_from(u64::from_le_bytes(*length)).unwrap();
            assert_eq!(after[..4], masked(length).to_le_bytes());
            let body = &after[4..4 + size];
            assert_eq!(after[4 + size..8 + size], masked(body).to_le_bytes());
            events.push(Event::decode(body).unwrap());
            rest = &after[8 + size..];
        }
        assert_eq!(events[0].file_version.as_deref(), Some(VERSION));
        let value = &events[1].summary.as_ref().unwrap().value[0];
        assert_eq!((events.len(), events[1].step, value.tag.as_str(), value.simple_value), (2, 7, "train/loss", 0.5));
    }
}
