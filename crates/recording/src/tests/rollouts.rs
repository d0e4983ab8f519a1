//! Recordings of sessions, read with tasks of every kind.

use std::io::Cursor;

use ::image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};

use crate::image::{PixelFormat, encode_jpeg};
use crate::picture::Channel;
use crate::testing::arm;
use crate::write::tests::{START, step_data};
use crate::{CameraRef, EpisodeWriter, ImageRef, ObservationRef, Reading, RecordingError, read_episode};
use gleaner_core::{Alignment, Mapping, TaskSpec};

fn image(format: PixelFormat, data: &[u8]) -> ImageRef<'_> {
    ImageRef { format, data }
}

/// Writes the step's observation with raw images.
fn observe(writer: &mut EpisodeWriter<Cursor<Vec<u8>>>, spec: &TaskSpec, stamp: i64, step: u8) {
    let (frames, proprioception, _) = step_data(spec, step);
    let (color, depth) = frames.split_at(Channel::Color.bytes(&spec.cameras[0]));
    let cameras =
        [CameraRef { color: image(PixelFormat::Rgb8, color), depth: Some(image(PixelFormat::Depth16, depth)) }];
    let observation = ObservationRef { cameras: &cameras, proprioception: &proprioception };
    writer.check(observation).unwrap();
    writer.observe(stamp, observation).unwrap();
}

/// A session whose observations have these stamps, the first `idle` of them without an action.
fn session(spec: &TaskSpec, stamps: &[i64], idle: usize) -> Vec<u8> {
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), spec).unwrap();
    for (at, &stamp) in stamps.iter().enumerate() {
        let step = u8::try_from(at).unwrap();
        observe(&mut writer, spec, stamp, step);
        if at >= idle {
            writer.act(stamp, &step_data(spec, step).2).unwrap();
        }
        writer.annotate("/policy/action", stamp, &serde_json::json!({"actions": [[step]]})).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

fn read(bytes: &[u8], spec: &TaskSpec) -> Result<Reading, RecordingError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, bytes).unwrap();
    read_episode(&path, spec)
}

fn even(steps: i64) -> Vec<i64> {
    (0..steps).map(|at| START + at * 100_000_000).collect()
}

#[test]
fn raw_images_and_numbers_read_back_exactly() {
    let spec = arm();
    let reading = read(&session(&spec, &even(9), 0), &spec).unwrap();
    assert_eq!((reading.mapping.as_str(), reading.report.findings.len()), ("gleaner", 0));
    let expected: Vec<_> = (0..9).map(|step| step_data(&spec, step)).collect();
    assert!(reading.episode.frames().as_ref() == expected.iter().flat_map(|s| s.0.clone()).collect::<Vec<_>>());
    assert_eq!(reading.episode.proprioception(), expected.iter().flat_map(|s| s.1.clone()).collect::<Vec<_>>());
    assert_eq!(reading.episode.action(), expected.iter().flat_map(|s| s.2.clone()).collect::<Vec<_>>());
}

/// Observations that are up to 40 ms late or 30 ms early, in order, are one step each.
#[test]
fn jitter_loses_no_step() {
    let jitter = [0, 40, -30, 25, -10, 40, 40, -30, -30, 13, 0, 7];
    let stamps: Vec<i64> = even(12).iter().zip(jitter).map(|(stamp, ms)| stamp + ms * 1_000_000).collect();
    for alignment in [Alignment::LatestBefore, Alignment::Nearest] {
        let spec = TaskSpec { alignment, ..arm() };
        let reading = read(&session(&spec, &stamps, 0), &spec).unwrap();
        assert_eq!(reading.episode.stamps(), stamps);
        let size = crate::frame_bytes_per_step(&spec);
        for (at, frame) in reading.episode.frames().as_ref().chunks_exact(size).enumerate() {
            assert!(frame == step_data(&spec, u8::try_from(at).unwrap()).0, "step {at} has the image of another step");
        }
    }
}

#[test]
fn clock_may_start_at_zero() {
    let spec = arm();
    let stamps: Vec<i64> = (0..5).map(|at| at * 100_000_000).collect();
    assert_eq!(read(&session(&spec, &stamps, 0), &spec).unwrap().episode.stamps(), stamps);
}

#[test]
fn observations_before_the_first_action_are_not_steps() {
    let spec = arm();
    let reading = read(&session(&spec, &even(6), 2), &spec).unwrap();
    assert_eq!(reading.episode.stamps(), &even(6)[2..]);
    assert_eq!(reading.episode.action()[..2], step_data(&spec, 2).2);
}

#[test]
fn every_task_reads_a_session_with_any_mappings() {
    let bytes = session(&arm(), &even(4), 0);
    let mut none = arm();
    none.mappings.clear();
    let mut same_name = arm();
    same_name.mappings[0].name = "gleaner".into();
    // A mapping of the session's topics, with fields that these topics do not have.
    let mut same_topics = arm();
    let Mapping { cameras, fields, .. } = &mut same_topics.mappings[0];
    cameras[0].color = "/camera/front/color".into();
    cameras[0].depth = Some("/camera/front/depth".into());
    fields.iter_mut().for_each(|field| field.topic = "/robot/action".into());
    for spec in [none, same_name, same_topics] {
        let reading = read(&bytes, &spec).unwrap();
        assert_eq!((reading.mapping.as_str(), reading.report.steps), ("gleaner", 4));
    }
}

#[test]
fn findings_name_the_mappings_of_the_task_only() {
    let mut other = arm();
    other.action[0].name = "another".into();
    other.mappings.clear();
    let refused = read(&session(&other, &even(4), 0), &arm()).unwrap_err().to_string();
    assert!(refused.contains("`json`") && !refused.contains("`gleaner`"), "{refused}");
}

#[test]
fn compressed_images_are_kept_byte_for_byte() {
    let cameras = vec![crate::CameraSpec { depth: false, ..arm().cameras.remove(0) }];
    let spec = TaskSpec { cameras, mappings: Vec::new(), ..arm() };
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &spec).unwrap();
    let jpeg = encode_jpeg(&[90, 30, 200].repeat(128), 8, 16, 55).unwrap();
    for (at, &stamp) in even(3).iter().enumerate() {
        // With a stated format, with a detected one, and raw.
        let raw = [7; 384];
        let color = [image(PixelFormat::Jpeg, &jpeg), image(PixelFormat::Auto, &jpeg), image(PixelFormat::Auto, &raw)];
        let cameras = [CameraRef { color: color[at], depth: None }];
        writer.observe(stamp, ObservationRef { cameras: &cameras, proprioception: &[0.0; 3] }).unwrap();
        writer.act(stamp, &[0.0; 2]).unwrap();
    }
    writer.flush().unwrap();
    let bytes = writer.finish().unwrap().into_inner();
    let decoded = crate::decode_color(&jpeg, PixelFormat::Jpeg, &spec.cameras[0].sizes()).unwrap();
    let reading = read(&bytes, &spec).unwrap();
    assert!(reading.episode.frames().as_ref() == [decoded.clone(), decoded, vec![7; 384]].concat());
}

/// The compressedDepth format of ROS has some bytes before the PNG, which decoding skips too.
#[test]
fn depth_that_ros_has_compressed_is_kept_as_its_png() {
    let spec = TaskSpec { mappings: Vec::new(), ..arm() };
    let mut png = Vec::new();
    let pixels = [7_u16; 128].map(u16::to_ne_bytes).concat();
    PngEncoder::new(&mut png).write_image(&pixels, 16, 8, ExtendedColorType::L16).unwrap();
    let (color, depth) = ([9; 384], [&[0; 12][..], &png].concat());
    let cameras =
        [CameraRef { color: image(PixelFormat::Rgb8, &color), depth: Some(image(PixelFormat::Auto, &depth)) }];
    let observation = ObservationRef { cameras: &cameras, proprioception: &[0.0; 3] };
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &spec).unwrap();
    for stamp in even(2) {
        writer.check(observation).unwrap();
        writer.observe(stamp, observation).unwrap();
        writer.act(stamp, &[0.0; 2]).unwrap();
    }
    let reading = read(&writer.finish().unwrap().into_inner(), &spec).unwrap();
    let step = [&color[..], &[7, 0].repeat(128)].concat();
    assert!(reading.episode.frames().as_ref() == [step.clone(), step].concat());
}

#[test]
fn invalid_observations_are_refused_before_they_are_written() {
    let spec = arm();
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &spec).unwrap();
    let (color, depth, short) = ([1; 384], [2; 256], [3; 5]);
    let good = CameraRef { color: image(PixelFormat::Rgb8, &color), depth: Some(image(PixelFormat::Depth16, &depth)) };
    let broken = image(PixelFormat::Jpeg, b"\xff\xd8\xff\xe0 broken");
    let mut problem = |cameras: &[CameraRef<'_>], proprioception: &[f32]| {
        let observation = ObservationRef { cameras, proprioception };
        let checked = writer.check(observation).unwrap_err().to_string();
        (checked, writer.observe(START, observation).is_err())
    };
    let refused = |(error, refused): (String, bool), word: &str| assert!(refused && error.contains(word), "{error}");
    refused(problem(&[], &[0.0; 3]), "cameras");
    refused(problem(&[CameraRef { depth: None, ..good }], &[0.0; 3]), "depth");
    refused(problem(&[good], &[0.0; 2]), "proprioception");
    refused(problem(&[good], &[0.0, f32::NAN, 0.0]), "proprioception[1]");
    refused(problem(&[CameraRef { color: image(PixelFormat::Rgb8, &short), ..good }], &[0.0; 3]), "5 bytes");
    // This one is found by decoding only.
    let (error, written) = problem(&[CameraRef { color: broken, ..good }], &[0.0; 3]);
    assert!(error.contains("JPEG") && !written, "{error}");
    assert!(writer.act(START, &[0.0, f32::INFINITY]).unwrap_err().to_string().contains("action[1]"));
    assert!(writer.act(-1, &[0.0; 2]).is_err());
}
