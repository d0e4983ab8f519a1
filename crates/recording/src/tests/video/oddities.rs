//! Video that is read although it is unusual, or whose stamps are wrong: the same steps each time, with a finding where
//! one is due.

use gleaner_video::{Format, Stream};
use serde_json::json;

use super::{Film, frames, task};
use crate::tests::scene::{Scene, check};
use crate::{FindingCode, Severity, TaskSpec};

/// The task with pictures of another size.
fn sized(height: u32, width: u32) -> TaskSpec {
    let mut spec = task();
    (spec.cameras[0].height, spec.cameras[0].width) = (height, width);
    spec
}

#[test]
fn ten_bits_and_full_range_are_read_as_the_decoder_shows_them() {
    for name in ["h264_high10", "h264_full", "h264_709", "h265_main10", "h265_709_full", "av1_10"] {
        let film = Film::read(name);
        let reading = film.scene().read(&task()).unwrap();
        assert!(frames(&reading) == film.pictures(), "{name}");
    }
    // The same scene, of which one stream uses the full range: its colors must not be stretched.
    let (full, limited) = (Film::read("h264_full").pictures(), Film::read("h264_baseline").pictures());
    let mean = |picture: &[u8]| picture.iter().map(|&value| u64::from(value)).sum::<u64>() / picture.len() as u64;
    assert!(mean(&full[0]).abs_diff(mean(&limited[0])) < 6, "{} {}", mean(&full[0]), mean(&limited[0]));
}

#[test]
fn odd_sizes_are_read() {
    let film = Film::read("av1_odd");
    let reading = film.scene().read(&sized(49, 65)).unwrap();
    assert_eq!(reading.report.findings, []);
    let Format::Video(codec) = Format::named(&film.format) else { panic!("{}", film.format) };
    let mut stream = Stream::new(codec, (49, 65)).unwrap();
    let mut outcomes: Vec<_> = film.messages.iter().enumerate().flat_map(|(at, data)| stream.push(at, data)).collect();
    outcomes.extend(stream.end());
    let expected: Vec<u8> = outcomes.into_iter().flat_map(|outcome| outcome.picture.unwrap().rgb()).collect();
    assert!(reading.episode.frames().as_ref() == expected);
}

/// The pictures of the steps, and the findings; the same when the recording is read again.
fn read(scene: &Scene) -> (Vec<Vec<u8>>, Vec<(Severity, FindingCode)>) {
    let once = || {
        let reading = scene.read(&task()).unwrap();
        let findings = reading.report.findings.iter().map(|finding| (finding.severity, finding.code)).collect();
        (frames(&reading), findings)
    };
    let first = once();
    assert!(first == once());
    first
}

#[test]
fn swapped_stamps_of_video_are_sorted_and_a_finding() {
    let film = Film::read("h264_baseline");
    let scene = film.scene().change("/front/color", |at, stamp, _| {
        *stamp += match at {
            4 => 100,
            5 => -100,
            _ => 0,
        };
        true
    });
    let mut expected = film.pictures();
    expected.swap(4, 5);
    let (found, findings) = read(&scene);
    assert!(found == expected);
    assert_eq!(findings, [(Severity::Warning, FindingCode::TimeReversed)]);
}

#[test]
fn a_stamp_far_in_the_future_is_held_off_and_a_finding() {
    let film = Film::read("h264_baseline");
    let scene = film.scene().change("/front/color", |at, stamp, _| {
        *stamp += if at == 5 { 3_600_000 } else { 0 };
        true
    });
    let mut expected = film.pictures();
    expected[5] = expected[4].clone();
    let (found, findings) = read(&scene);
    assert!(found == expected);
    assert_eq!(findings, [(Severity::Warning, FindingCode::TimeReversed)]);
}

/// A recorder that fills no stamp in writes zero, for which the time of logging stands.
#[test]
fn stamps_of_zero_are_no_stamps() {
    let film = Film::read("h264_baseline");
    let scene = film.scene().change("/front/color", |_, stamp, _| {
        *stamp = 0;
        true
    });
    let (found, findings) = read(&scene);
    assert!(found == film.pictures());
    assert_eq!(findings, []);
}

#[test]
fn stamps_that_stand_still_are_a_finding() {
    let film = Film::read("h264_baseline");
    let scene = film.scene().change("/front/color", |_, stamp, _| {
        *stamp = 1000;
        true
    });
    let (found, findings) = read(&scene);
    assert!(found.iter().all(|picture| *picture == film.pictures()[11]));
    assert_eq!(findings, [(Severity::Warning, FindingCode::Gap)]);
}

#[test]
fn a_stretch_of_zeros_in_a_picture_gives_the_same_steps_again() {
    for name in ["h264_main", "h265_low_delay", "av1_aom"] {
        let mut film = Film::read(name);
        let message = &mut film.messages[3];
        let middle = message.len() / 2;
        message[middle..].iter_mut().take(24).for_each(|byte| *byte = 0);
        let once = |film: &Film| film.scene().read(&task()).map(|reading| frames(&reading)).map_err(|e| e.to_string());
        assert!(once(&film) == once(&film), "{name}");
    }
}

#[test]
fn a_codec_that_changes_in_the_middle_begins_at_its_key_frame() {
    let (first, second) = (Film::read("h264_baseline"), Film::read("h265_low_delay"));
    let mut scene = first.scene();
    let other = second.scene();
    let of = |scene: &Scene| -> Vec<_> { scene.messages.iter().filter(|m| m.0 == "/front/color").cloned().collect() };
    let mixed: Vec<_> = of(&scene).into_iter().take(6).chain(of(&other).into_iter().skip(6)).collect();
    scene.messages.retain(|message| message.0 != "/front/color");
    scene.messages.extend(mixed);
    let (found, findings) = read(&scene);
    let expected: Vec<Vec<u8>> =
        first.pictures().into_iter().take(6).chain(second.pictures().into_iter().skip(6)).collect();
    assert!(found == expected);
    assert_eq!(findings, []);
}

#[test]
fn a_codec_without_a_decoder_in_the_middle_is_named() {
    let scene = Film::read("h264_baseline").scene().change("/front/color", |at, _, content| {
        if at >= 6 {
            content["format"] = json!("vp9");
        }
        true
    });
    let finding = check(&scene.report(&task()), Severity::Error, FindingCode::BrokenImage, "/front/color");
    assert!(finding.first_step == Some(6) && finding.detail.contains("`vp9`"), "{finding:?}");
}
