//! Damaged and hostile streams: a picture that comes out is the one that was recorded, and work stays bounded.

use super::fixture::{Fixture, Pictures, assert_true, decode};
use crate::annex_b::units;
use crate::{Codec, VideoError};

const STREAMS: [&str; 7] =
    ["h264_baseline", "h264_main", "h264_b_frames", "h264_mbaff", "h265_main", "h265_low_delay", "av1_aom"];

fn without(fixture: &Fixture, dropped: usize) -> Pictures {
    fixture.decode_these(fixture.data.iter().cloned().enumerate().filter(|(at, _)| *at != dropped))
}

#[test]
fn pictures_after_a_missing_message_are_lost_up_to_the_next_key_frame() {
    for name in STREAMS.into_iter().chain(["av1_svt", "av1_odd", "av1_10", "av1_timed"]) {
        let fixture = Fixture::read(name);
        // The order hints of AV1 show a gap once they have increased by one.
        let first = if fixture.codec() == Codec::Av1 { 2 } else { 1 };
        let mut lost = 0;
        for dropped in first..6 {
            let pictures = without(&fixture, dropped);
            let shown = assert_true(&fixture, &pictures, &format!("{name} without {dropped}"));
            assert!((6..12).all(|at| shown.contains(&at)), "{name} without {dropped}: {shown:?}");
            lost += 11 - shown.len();
        }
        assert!(lost > 0, "{name}");
    }
}

#[test]
fn a_message_that_ends_early_has_no_picture() {
    for name in STREAMS {
        let fixture = Fixture::read(name);
        let (mut found, mut cuts) = (0, 0);
        for at in 0..fixture.data.len() {
            let whole = fixture.data[at].len();
            for keep in [whole / 3, whole * 2 / 3, whole.saturating_sub(8).max(1)] {
                let mut messages: Vec<(usize, Vec<u8>)> = fixture.data.iter().cloned().enumerate().collect();
                messages[at].1.truncate(keep);
                let pictures = fixture.decode_these(messages);
                let case = format!("{name}, message {at} cut to {keep} of {whole}");
                let shown = assert_true(&fixture, &pictures, &case);
                (found, cuts) = (found + usize::from(shown.len() < fixture.data.len()), cuts + 1);
            }
        }
        assert!(found * 10 >= cuts * 9, "{name}: {found} of {cuts} cuts found");
    }
}

#[test]
fn every_message_of_another_size_is_refused_with_both_sizes() {
    for name in STREAMS {
        let fixture = Fixture::read(name);
        let pictures = decode(fixture.codec(), (40, 64), fixture.data.iter().cloned().enumerate());
        assert_eq!(pictures.len(), 12, "{name}");
        for picture in pictures.values() {
            let Err(VideoError::WrongSize { height: 40, width: 64, found_height, found_width }) = picture else {
                panic!("{name}: {picture:?}")
            };
            assert_eq!((*found_height, *found_width), (48, 64), "{name}");
        }
    }
}

#[test]
fn a_size_that_changes_is_refused_from_there() {
    for (name, other) in [("h264_baseline", "h264_cropped"), ("h265_low_delay", "h265_cropped"), ("av1_aom", "av1_odd")]
    {
        let (small, other) = (Fixture::read(name), Fixture::read(other));
        let messages = small.data.iter().take(6).chain(&other.data).cloned().enumerate();
        let pictures = decode(small.codec(), (48, 64), messages);
        assert_eq!(pictures.len(), 6 + other.data.len(), "{name}");
        assert_eq!(assert_true(&small, &pictures, name), [0, 1, 2, 3, 4, 5], "{name}");
        for (at, picture) in pictures.range(6..) {
            let Err(VideoError::WrongSize { height: 48, width: 64, found_height, found_width }) = picture else {
                panic!("{name}, message {at}: {picture:?}")
            };
            assert_eq!((*found_height, *found_width), (other.height, other.width), "{name}, message {at}");
        }
    }
}

/// Appends bits, most significant first.
#[derive(Default)]
struct Bits(Vec<bool>);

impl Bits {
    fn put(mut self, value: u32, count: u32) -> Self {
        self.0.extend((0..count).rev().map(|bit| value >> bit & 1 == 1));
        self
    }

    /// An Exp-Golomb number.
    fn number(self, value: u32) -> Self {
        let length = (value + 1).ilog2();
        self.put(0, length).put(value + 1, length + 1)
    }

    fn bytes(self) -> Vec<u8> {
        let bits = self.put(1, 1).0;
        bits.chunks(8)
            .map(|bits| bits.iter().enumerate().fold(0, |byte, (at, &bit)| byte | u8::from(bit) << (7 - at)))
            .collect()
    }
}

/// A sequence parameter set of this many macroblocks, cropped to 48×64 pixels or not.
fn claiming(columns: u32, rows: u32, cropped: bool) -> Vec<u8> {
    let bits = Bits::default().put(66, 8).put(0, 8).put(51, 8).number(0).number(0).number(2).number(1).put(0, 1);
    let bits = bits.number(columns - 1).number(rows - 1).put(1, 1).put(0, 1).put(u32::from(cropped), 1);
    let bits = if cropped {
        bits.number(0).number((columns * 16 - 64) / 2).number(0).number((rows * 16 - 48) / 2)
    } else {
        bits
    };
    let body = bits.put(0, 1).bytes();
    assert!(!body.windows(3).any(|bytes| bytes[..2] == [0, 0] && bytes[2] <= 3), "it needs no escape");
    [&[0, 0, 0, 1, 0x67][..], &body].concat()
}

#[test]
fn a_huge_claim_is_refused_before_it_is_decoded() {
    let fixture = Fixture::read("h264_baseline");
    for cropped in [false, true] {
        let units = units(Codec::H264, &fixture.data[0]).unwrap();
        let slice = units.into_iter().find(|unit| unit[0] & 0x1f == 5).unwrap();
        let set = [0, 0, 0, 1, 0x68, 0xce, 0x38, 0x80, 0, 0, 0, 1];
        let message = [&claiming(1024, 1024, cropped)[..], &set, slice].concat();
        let pictures = decode(Codec::H264, (48, 64), [(0, message)]);
        let Err(VideoError::WrongSize { found_height, found_width, .. }) = &pictures[&0] else {
            panic!("{:?}", pictures[&0])
        };
        assert_eq!((*found_height, *found_width), (16384, 16384));
    }
}

#[test]
fn foreign_bytes_are_named_and_later_key_frames_decode() {
    for name in STREAMS {
        let fixture = Fixture::read(name);
        let mut messages: Vec<(usize, Vec<u8>)> = fixture.data.iter().cloned().enumerate().collect();
        messages[2].1 = b"\xff\xd8\xff a JPEG".to_vec();
        let pictures = fixture.decode_these(messages);
        assert!(matches!(pictures[&2], Err(VideoError::Damaged(_))), "{name}: {:?}", pictures[&2]);
        assert!((3..6).all(|at| pictures[&at] == Err(VideoError::Lost)), "{name}");
        let shown = assert_true(&fixture, &pictures, name);
        assert_eq!(shown, [0, 1, 6, 7, 8, 9, 10, 11], "{name}");
    }
}

#[test]
fn damaged_bytes_have_the_same_outcomes_again() {
    let mut random = 0x9e37_79b9_7f4a_7c15_u64;
    let mut below = |end: usize| {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        usize::try_from(random % end as u64).unwrap()
    };
    for name in STREAMS {
        let fixture = Fixture::read(name);
        for _ in 0..25 {
            let mut messages: Vec<(usize, Vec<u8>)> = fixture.data.iter().cloned().enumerate().collect();
            for _ in 0..=below(4) {
                let data = &mut messages[below(12)].1;
                let at = below(data.len());
                data[at] ^= 1 << below(8);
            }
            assert!(fixture.decode_these(messages.clone()) == fixture.decode_these(messages), "{name}");
        }
    }
}
