//! The streams in `fixtures/` and what another decoder finds in them.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use crate::{Codec, Format, Outcome, Picture, Stream, VideoError};

/// A stream.
#[derive(Deserialize)]
pub(super) struct Fixture {
    format: String,
    pub(super) height: u32,
    pub(super) width: u32,
    /// What FFmpeg found in each message.
    pub(super) messages: Vec<Expected>,
    #[serde(skip)]
    pub(super) data: Vec<Vec<u8>>,
}

/// The picture of a message.
#[derive(Deserialize)]
pub(super) struct Expected {
    /// Place in the order of presentation.
    pub(super) order: i64,
    /// CRC-32 of each plane.
    pub(super) planes: Vec<u32>,
    /// Row, column, red, green and blue of some pixels.
    pub(super) pixels: Vec<[usize; 5]>,
}

/// A message's picture or why it has none, by its number.
pub(super) type Pictures = BTreeMap<usize, Result<Picture, VideoError>>;

impl Fixture {
    pub(super) fn read(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
        let described = std::fs::read(folder.join(format!("{name}.json"))).unwrap();
        let mut fixture: Self = serde_json::from_slice(&described).unwrap();
        let packets = std::fs::read(folder.join(format!("{name}.packets"))).unwrap();
        let mut rest = packets.as_slice();
        while let Some((length, after)) = rest.split_first_chunk() {
            let (data, after) = after.split_at(u32::from_le_bytes(*length) as usize);
            fixture.data.push(data.to_vec());
            rest = after;
        }
        assert_eq!(fixture.data.len(), fixture.messages.len(), "{name}");
        fixture
    }

    pub(super) fn codec(&self) -> Codec {
        let Format::Video(codec) = Format::named(&self.format) else { panic!("{} is no codec", self.format) };
        codec
    }

    /// What becomes of the messages of the fixture.
    pub(super) fn decode(&self) -> Pictures {
        self.decode_these(self.data.iter().cloned().enumerate())
    }

    /// What becomes of these messages in a stream of the fixture's size.
    pub(super) fn decode_these(&self, messages: impl IntoIterator<Item = (usize, Vec<u8>)>) -> Pictures {
        decode(self.codec(), (self.height, self.width), messages)
    }
}

/// What becomes of these messages; each has at most one outcome.
pub(super) fn decode(codec: Codec, size: (u32, u32), messages: impl IntoIterator<Item = (usize, Vec<u8>)>) -> Pictures {
    let mut stream = Stream::new(codec, size).unwrap();
    let mut pictures = Pictures::new();
    let mut keep = |outcomes: Vec<Outcome>| {
        for Outcome { message, picture } in outcomes {
            assert!(pictures.insert(message, picture).is_none(), "message {message} has two outcomes");
        }
    };
    for (message, data) in messages {
        keep(stream.push(message, &data));
    }
    keep(stream.end());
    pictures
}

/// CRC-32 of each plane, as FFmpeg lays them out.
pub(super) fn sums(picture: &Picture) -> Vec<u32> {
    let planes = std::iter::once(&picture.luma).chain(picture.chroma.iter().flatten());
    let bytes = planes.map(|plane| -> Vec<u8> {
        let samples = plane.samples.iter();
        if picture.depth > 8 {
            samples.flat_map(|sample| sample.to_le_bytes()).collect()
        } else {
            samples.map(|&sample| u8::try_from(sample).unwrap()).collect()
        }
    });
    bytes.map(|bytes| crc32fast::hash(&bytes)).collect()
}

/// Asserts that every picture is the one that FFmpeg found in its message; returns the messages with pictures.
pub(super) fn assert_true(fixture: &Fixture, pictures: &Pictures, case: &str) -> Vec<usize> {
    let mut shown = Vec::new();
    for (&message, picture) in pictures {
        if let Ok(picture) = picture {
            assert_eq!(sums(picture), fixture.messages[message].planes, "{case}: message {message}");
            shown.push(message);
        }
    }
    shown
}
