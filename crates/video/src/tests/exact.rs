//! Every picture is the one that FFmpeg decodes, sample by sample, and its RGB is within two levels of libswscale's.

use super::fixture::{Fixture, decode, sums};
use crate::VideoError;

fn check(name: &str) {
    let fixture = Fixture::read(name);
    let pictures = fixture.decode();
    assert_eq!(pictures.len(), fixture.messages.len(), "{name}");
    let mut orders = Vec::new();
    for (message, expected) in fixture.messages.iter().enumerate() {
        let picture = pictures[&message].as_ref().unwrap_or_else(|error| panic!("{name}, message {message}: {error}"));
        assert_eq!(sums(picture), expected.planes, "{name}, message {message}");
        let (rgb, width) = (picture.rgb(), fixture.width as usize);
        for [row, column, color @ ..] in &expected.pixels {
            let found = &rgb[(row * width + column) * 3..][..3];
            let near = found.iter().zip(color).all(|(&found, &wanted)| usize::from(found).abs_diff(wanted) <= 2);
            assert!(near, "{name}, message {message}, pixel {row}, {column}: {found:?} for {color:?}");
        }
        orders.push((expected.order, picture.order));
    }
    // Within a group of pictures, both orders agree.
    for group in orders.chunks(6) {
        let mut group = group.to_vec();
        group.sort_unstable();
        assert!(group.is_sorted_by_key(|(_, order)| *order), "{name}: {group:?}");
    }
}

#[test]
fn h264_is_exact_in_each_profile() {
    for name in ["h264_baseline", "h264_main", "h264_b_frames", "h264_high10", "h264_422"] {
        check(name);
    }
}

/// Rows of both fields in each frame, in macroblocks of frames and of fields.
#[test]
fn interlaced_frames_are_exact() {
    check("h264_mbaff");
}

#[test]
fn h265_is_exact_with_and_without_reordering() {
    for name in ["h265_main", "h265_low_delay", "h265_main10"] {
        check(name);
    }
    let open = Fixture::read("h265_open");
    let pictures = open.decode();
    assert_eq!(super::fixture::assert_true(&open, &pictures, "open").len(), 18);
}

#[test]
fn av1_is_exact_at_odd_sizes_and_in_each_layout() {
    for name in ["av1_aom", "av1_svt", "av1_odd", "av1_10", "av1_444"] {
        check(name);
    }
}

#[test]
fn matrix_range_and_cropping_of_the_stream_are_followed() {
    for name in ["h264_709", "h264_full", "h264_cropped", "h265_709_full", "h265_cropped"] {
        check(name);
    }
}

#[test]
fn layouts_without_a_decoder_are_named() {
    for name in ["h264_444", "h265_444"] {
        for (message, picture) in Fixture::read(name).decode() {
            let Err(error @ VideoError::Unsupported(_)) = picture else { panic!("{name}, message {message}") };
            assert!(error.to_string().contains("4:2:0"), "{error}");
        }
    }
}

/// A decoder would return each field as a picture of half the height.
#[test]
fn pictures_of_single_fields_are_refused_with_the_fix() {
    for (name, filter) in [("h264_fields", "-vf yadif"), ("h265_fields", "-vf weave,yadif")] {
        let fixture = Fixture::read(name);
        // A camera of H.265 may have the size of a field or that of a frame.
        for height in [fixture.height, 2 * fixture.height].into_iter().take(if name == "h265_fields" { 2 } else { 1 }) {
            let pictures = decode(fixture.codec(), (height, fixture.width), fixture.data.iter().cloned().enumerate());
            assert_eq!(pictures.len(), 2, "{name}");
            for (message, picture) in pictures {
                let Err(error @ VideoError::Unsupported(_)) = picture else { panic!("{name}, message {message}") };
                let error = error.to_string();
                assert!(
                    ["field pictures", "record progressive", filter].iter().all(|word| error.contains(word)),
                    "{error}"
                );
            }
        }
    }
}
