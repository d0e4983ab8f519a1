//! Video in recordings: streams of `gleaner-video`'s fixtures as messages.

mod oddities;
mod stretches;

use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use gleaner_video::{Format, Stream};
use serde_json::{Value, json};

use super::scene::{Scene, check, read_bytes};
use crate::testing::arm;
use crate::{FindingCode, Reading, RecordingError, Severity, TaskSpec};

/// Bytes of one picture.
const PIXELS: usize = 48 * 64 * 3;

/// A task with one camera of 48×64 pixels without depth.
pub(crate) fn task() -> TaskSpec {
    let mut spec = arm();
    let camera = &mut spec.cameras[0];
    (camera.height, camera.width, camera.depth) = (48, 64, false);
    spec.mappings[0].cameras[0].depth = None;
    spec
}

/// A stream: its format, the messages, and the place of each in the order of presentation.
pub(crate) struct Film {
    pub(crate) format: String,
    pub(crate) messages: Vec<Vec<u8>>,
    pub(crate) orders: Vec<i64>,
}

impl Film {
    pub(crate) fn read(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../video/fixtures");
        let described = std::fs::read(folder.join(format!("{name}.json"))).unwrap();
        let described: Value = serde_json::from_slice(&described).unwrap();
        let packets = std::fs::read(folder.join(format!("{name}.packets"))).unwrap();
        let (mut rest, mut messages) = (packets.as_slice(), Vec::new());
        while let Some((length, after)) = rest.split_first_chunk() {
            let (data, after) = after.split_at(u32::from_le_bytes(*length) as usize);
            messages.push(data.to_vec());
            rest = after;
        }
        let orders = described["messages"].as_array().unwrap().iter().map(|message| message["order"].as_i64().unwrap());
        Self { format: described["format"].as_str().unwrap().to_owned(), orders: orders.collect(), messages }
    }

    /// RGB of each picture in the order of presentation.
    pub(crate) fn pictures(&self) -> Vec<Vec<u8>> {
        let Format::Video(codec) = Format::named(&self.format) else { panic!("{} is no codec", self.format) };
        let mut stream = Stream::new(codec, (48, 64)).unwrap();
        let mut outcomes: Vec<_> =
            self.messages.iter().enumerate().flat_map(|(at, data)| stream.push(at, data)).collect();
        outcomes.extend(stream.end());
        let mut pictures = vec![Vec::new(); self.messages.len()];
        for outcome in outcomes {
            pictures[usize::try_from(self.orders[outcome.message]).unwrap()] = outcome.picture.unwrap().rgb();
        }
        pictures
    }

    /// A recording with a step for each picture, stamped with the time at which it is shown.
    pub(super) fn scene(&self) -> Scene {
        let mut scene = Scene::steps(i64::try_from(self.messages.len()).unwrap());
        for (at, (data, order)) in self.messages.iter().zip(&self.orders).enumerate() {
            let content = json!({"format": self.format, "frame_id": "front", "data": STANDARD.encode(data)});
            let logged = 1000 + i64::try_from(at).unwrap() * 100;
            scene.messages.push(("/front/color", Some(1000 + order * 100), logged, content));
        }
        scene
    }
}

/// The pictures of the steps.
pub(crate) fn frames(reading: &Reading) -> Vec<Vec<u8>> {
    reading.episode.frames().as_ref().chunks(PIXELS).map(<[u8]>::to_vec).collect()
}

#[test]
fn each_step_has_the_picture_of_its_time() {
    for name in ["h264_baseline", "h264_b_frames", "h265_main", "h265_low_delay", "av1_aom"] {
        let film = Film::read(name);
        let reading = film.scene().read(&task()).unwrap();
        assert!(frames(&reading) == film.pictures(), "{name}");
        // Pictures that are shown in another order than they are decoded have stamps in that order.
        let reordered = !film.orders.is_sorted();
        let expected: &[FindingCode] = if reordered { &[FindingCode::TimeReversed] } else { &[] };
        let found: Vec<FindingCode> = reading.report.findings.iter().map(|finding| finding.code).collect();
        assert_eq!(found, expected, "{name}");
    }
}

#[test]
fn a_step_is_a_crop_of_the_recorded_picture() {
    let film = Film::read("h264_baseline");
    let mut spec = task();
    let recorded = gleaner_core::RecordedSize {
        height: 48,
        width: 64,
        crop: Some(gleaner_core::Crop { top: 8, left: 16, height: 24, width: 32 }),
    };
    let camera = &mut spec.cameras[0];
    (camera.height, camera.width, camera.recorded) = (24, 32, Some(recorded));
    let reading = film.scene().read(&spec).unwrap();
    let whole = film.pictures();
    let cut = |picture: &Vec<u8>| -> Vec<u8> {
        picture.chunks(64 * 3).skip(8).take(24).flat_map(|row| row[16 * 3..48 * 3].to_vec()).collect()
    };
    let expected: Vec<u8> = whole.iter().flat_map(cut).collect();
    assert!(reading.episode.frames().as_ref() == expected);
}

#[test]
fn steps_begin_at_the_first_key_frame() {
    for name in ["h264_baseline", "h265_low_delay", "av1_aom"] {
        let film = Film::read(name);
        let scene = film.scene().change("/front/color", |at, _, _| at >= 2);
        let reading = scene.read(&task()).unwrap();
        assert!(frames(&reading) == film.pictures()[6..], "{name}");
        let finding = check(&reading.report, Severity::Note, FindingCode::LateKeyFrame, "/front/color");
        assert!(finding.detail.contains("first key frame is message 4"), "{}", finding.detail);
    }
}

#[test]
fn damage_holds_the_last_whole_picture_and_is_a_finding() {
    for name in ["h264_baseline", "h264_main", "h265_low_delay"] {
        let mut film = Film::read(name);
        let whole = film.pictures();
        let length = film.messages[3].len();
        film.messages[3].truncate(length / 2);
        let reading = film.scene().read(&task()).unwrap();
        let mut expected = whole.clone();
        (3..6).for_each(|step| expected[step].clone_from(&whole[2]));
        assert!(frames(&reading) == expected, "{name}");
        let finding = check(&reading.report, Severity::Warning, FindingCode::BrokenImage, "/front/color");
        assert_eq!(finding.first_step, Some(3), "{name}");
        assert!(finding.detail.contains("3 steps have the last whole picture"), "{}", finding.detail);
        assert!(frames(&film.scene().read(&task()).unwrap()) == expected, "{name}: another reading differs");
    }
}

#[test]
fn a_dropped_message_is_damage_up_to_the_next_key_frame() {
    for name in ["h264_baseline", "av1_aom"] {
        let film = Film::read(name);
        let reading = film.scene().change("/front/color", |at, _, _| at != 8).read(&task()).unwrap();
        let (whole, found) = (film.pictures(), frames(&reading));
        assert!(found[..8] == whole[..8] && found[8..].iter().all(|picture| *picture == whole[7]), "{name}");
        check(&reading.report, Severity::Warning, FindingCode::BrokenImage, "/front/color");
    }
}

#[test]
fn a_damaged_first_picture_is_refused() {
    let mut film = Film::read("h264_baseline");
    let length = film.messages[0].len();
    film.messages[0].truncate(length - 40);
    let report = film.scene().report(&task());
    let finding = check(&report, Severity::Error, FindingCode::BrokenImage, "/front/color");
    assert_eq!(finding.first_step, Some(0));
}

#[test]
fn video_that_cannot_be_read_names_the_reason() {
    let film = Film::read("h264_baseline");
    let refused = |scene: Scene, code, words: &[&str]| {
        let report = scene.report(&task());
        let errors: Vec<_> = report.findings.iter().filter(|finding| finding.severity == Severity::Error).collect();
        let [finding] = errors[..] else { panic!("{errors:?}") };
        assert_eq!((finding.code, finding.subject.as_str()), (code, "/front/color"));
        assert!(words.iter().all(|word| finding.detail.contains(word)), "{}", finding.detail);
    };
    let with = |key: &'static str, value: &str| {
        let value = value.to_owned();
        film.scene().change("/front/color", move |_, _, content| {
            content[key] = json!(value);
            true
        })
    };
    refused(with("format", "vp9"), FindingCode::BrokenImage, &["`vp9`", "h264"]);
    refused(with("format", "h256"), FindingCode::BrokenImage, &["`h256`"]);
    refused(with("data", "AAAA"), FindingCode::BrokenImage, &["key frame", "Annex B"]);
    let late = film.scene().change("/front/color", |at, _, _| !at.is_multiple_of(6));
    refused(late, FindingCode::BrokenImage, &["no message is a key frame"]);
    refused(Film::read("h264_cropped").scene(), FindingCode::WrongSize, &["50×66", "48×64"]);
    refused(Film::read("h265_444").scene(), FindingCode::BrokenImage, &["4:2:0"]);
    refused(Film::read("h265_fields").scene(), FindingCode::BrokenImage, &["field pictures", "record progressive"]);
}

#[test]
fn a_size_that_changes_is_refused() {
    for (name, other) in [("h264_baseline", "h264_cropped"), ("h265_low_delay", "h265_cropped"), ("av1_aom", "av1_odd")]
    {
        let mut film = Film::read(name);
        film.messages.truncate(6);
        film.messages.extend(Film::read(other).messages.into_iter().take(6));
        let finding = check(&film.scene().report(&task()), Severity::Error, FindingCode::WrongSize, "/front/color");
        assert_eq!(finding.first_step, Some(6), "{name}");
    }
}

#[test]
fn cameras_of_other_rates_and_codecs_are_read_together() {
    let (slow, fast) = (Film::read("h265_low_delay"), Film::read("av1_aom"));
    let mut spec = task();
    spec.cameras.push(crate::CameraSpec { name: "wrist".into(), ..spec.cameras[0].clone() });
    let source = crate::CameraSource { camera: "wrist".into(), color: "/wrist/color".into(), depth: None };
    spec.mappings[0].cameras.push(source);
    let mut scene = Scene::steps(12);
    let message = |film: &Film, at: usize| json!({"format": film.format, "data": STANDARD.encode(&film.messages[at])});
    for at in 0..12_usize {
        let ms = 1000 + i64::try_from(at).unwrap() * 100;
        // One camera has a picture for two steps, the other two pictures for one step and begins late.
        if at.is_multiple_of(2) {
            scene.add("/front/color", ms, message(&slow, at / 2));
        }
        if at >= 6 {
            scene.add("/wrist/color", ms - 50, message(&fast, (at - 6) * 2));
            scene.add("/wrist/color", ms, message(&fast, (at - 6) * 2 + 1));
        }
    }
    let reading = scene.read(&spec).unwrap();
    let (slow, fast) = (slow.pictures(), fast.pictures());
    let expected: Vec<Vec<u8>> =
        (6..12).flat_map(|step| [slow[step / 2].clone(), fast[(step - 6) * 2 + 1].clone()]).collect();
    assert!(frames(&reading) == expected);
    check(&reading.report, Severity::Warning, FindingCode::LateStart, "/wrist/color");
}

/// The fields of FFMPEGPacket.
#[test]
fn packets_of_ros_are_read() {
    let film = Film::read("h264_b_frames");
    let scene = film.scene().change("/front/color", |at, _, content| {
        let data = content["data"].clone();
        *content = json!({
            "encoding": "libx264;yuv420p;bgr8;bgr8", "width": 64, "height": 48, "pts": at, "flags": 0, "data": data,
        });
        true
    });
    assert!(frames(&scene.read(&task()).unwrap()) == film.pictures());
}

#[test]
fn depth_as_video_is_refused() {
    let film = Film::read("h264_baseline");
    let mut spec = task();
    spec.cameras[0].depth = true;
    spec.mappings[0].cameras[0].depth = Some("/front/depth".into());
    let mut scene = film.scene();
    let messages: Vec<_> = scene.messages.iter().filter(|message| message.0 == "/front/color").cloned().collect();
    scene.messages.extend(messages.into_iter().map(|message| ("/front/depth", message.1, message.2, message.3)));
    let Err(RecordingError::Rejected(report)) = read_bytes(&scene.mcap(), &spec) else { panic!("accepted") };
    let finding = check(&report, Severity::Error, FindingCode::BrokenImage, "/front/depth");
    assert!(finding.detail.contains("h264"), "{}", finding.detail);
}
