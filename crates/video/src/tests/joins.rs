//! Where pictures begin: late joins, parameter sets and messages that hold none or several pictures.

use super::fixture::{Fixture, assert_true};
use crate::annex_b::units;
use crate::{Codec, Part, VideoError, glance};

/// Every sixth picture is a key frame.
const GROUP: usize = 6;

const STREAMS: [&str; 11] = [
    "h264_baseline",
    "h264_main",
    "h264_b_frames",
    "h264_high10",
    "h264_mbaff",
    "h265_main",
    "h265_low_delay",
    "h265_main10",
    "av1_aom",
    "av1_10",
    "av1_timed",
];

#[test]
fn a_glance_finds_the_key_frames() {
    for name in STREAMS {
        let fixture = Fixture::read(name);
        let keys: Vec<usize> = (0..fixture.data.len())
            .filter(|&at| glance(fixture.codec(), &fixture.data[at]).unwrap().part == Part::Key)
            .collect();
        assert_eq!(keys, [0, GROUP], "{name}");
        assert!(glance(fixture.codec(), &fixture.data[0]).unwrap().parameters, "{name}");
    }
}

#[test]
fn pictures_begin_at_the_first_key_frame() {
    for name in STREAMS {
        let fixture = Fixture::read(name);
        for begin in 1..GROUP {
            let pictures = fixture.decode_these(fixture.data.iter().cloned().enumerate().skip(begin));
            let shown = assert_true(&fixture, &pictures, name);
            assert_eq!(shown, (GROUP..fixture.data.len()).collect::<Vec<_>>(), "{name} from {begin}");
            assert!((begin..GROUP).all(|at| pictures[&at] == Err(VideoError::BeforeKey)), "{name} from {begin}");
        }
    }
}

/// Pictures of H.265 that are shown before a key frame may need the group before it.
#[test]
fn leading_pictures_need_the_group_before() {
    let fixture = Fixture::read("h265_open");
    let parts: Vec<Part> = fixture.data.iter().map(|data| glance(Codec::H265, data).unwrap().part).collect();
    let second = parts.iter().skip(1).position(|part| *part == Part::Key).unwrap() + 1;
    assert!(parts[second..].contains(&Part::Leading), "{parts:?}");
    let pictures = fixture.decode_these(fixture.data.iter().cloned().enumerate().skip(second));
    let shown = assert_true(&fixture, &pictures, "open");
    let without: Vec<usize> = pictures.keys().copied().filter(|at| !shown.contains(at)).collect();
    assert!(!without.is_empty() && without.iter().all(|&at| parts[at] == Part::Leading), "{without:?}");
}

#[test]
fn parameter_sets_at_the_first_key_frame_are_enough() {
    for name in ["h264_baseline", "h264_b_frames", "h265_main"] {
        let fixture = Fixture::read(name);
        let codec = fixture.codec();
        let is_set = |unit: &&[u8]| match codec {
            Codec::H264 => matches!(unit[0] & 0x1f, 7 | 8),
            Codec::H265 | Codec::Av1 => matches!(unit[0] >> 1, 32..=34),
        };
        let join = |units: Vec<&[u8]>| units.into_iter().flat_map(|unit| [&[0, 0, 0, 1], unit].concat()).collect();
        let (sets, rest): (Vec<_>, Vec<_>) = units(codec, &fixture.data[GROUP]).unwrap().into_iter().partition(is_set);
        assert!(!sets.is_empty(), "{name}");
        let mut messages: Vec<(usize, Vec<u8>)> = fixture.data.iter().cloned().enumerate().collect();
        messages[GROUP].1 = join(rest.clone());
        let pictures = fixture.decode_these(messages.clone());
        assert_eq!(assert_true(&fixture, &pictures, name).len(), fixture.data.len(), "{name}");
        // In a message of their own, which has no picture.
        messages.drain(..GROUP);
        messages.insert(0, (99, join(sets)));
        let pictures = fixture.decode_these(messages.clone());
        assert_eq!(assert_true(&fixture, &pictures, name).len(), fixture.data.len() - GROUP, "{name}");
        assert!(!pictures.contains_key(&99), "{name}");
        // Nowhere.
        messages.remove(0);
        assert!(fixture.decode_these(messages).values().all(Result::is_err), "{name}");
    }
}

#[test]
fn a_message_of_several_pictures_has_the_last() {
    for name in ["h264_baseline", "h264_main", "h265_low_delay", "av1_svt"] {
        let fixture = Fixture::read(name);
        let mut messages: Vec<(usize, Vec<u8>)> = fixture.data.iter().cloned().enumerate().collect();
        let (_, first) = messages.remove(2);
        messages[2].1 = [first, messages[2].1.clone()].concat();
        let pictures = fixture.decode_these(messages);
        let shown = assert_true(&fixture, &pictures, name);
        assert_eq!(shown, (0..fixture.data.len()).filter(|at| *at != 2).collect::<Vec<_>>(), "{name}");
    }
}

/// An encoder that begins again ends its sequence first.
#[test]
fn pictures_before_the_end_of_a_sequence_are_shown() {
    const END_OF_SEQUENCE: [u8; 6] = [0, 0, 0, 1, 36 << 1, 1];
    let fixture = Fixture::read("h265_709_full");
    let mut messages: Vec<(usize, Vec<u8>)> = fixture.data.iter().cloned().enumerate().collect();
    messages[GROUP - 1].1.extend(END_OF_SEQUENCE);
    let pictures = fixture.decode_these(messages);
    let shown = assert_true(&fixture, &pictures, "with an end");
    assert_eq!(shown, (0..fixture.data.len()).collect::<Vec<_>>());
}
