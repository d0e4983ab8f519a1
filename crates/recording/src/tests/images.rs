//! Images in JSON messages, and frozen cameras.

use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

use super::fixture;
use super::scene::{Scene, check, read_bytes};
use crate::testing::arm;
use crate::{
    Crop, FindingCode, PixelFormat, RecordedSize, Severity, TaskSpec, decode_color, decode_depth, encode_jpeg,
    encode_png, read_episode,
};

/// The pixels of a step: red follows the step.
fn color(step: usize) -> Vec<u8> {
    [u8::try_from(step * 5 % 256).unwrap(), 40, 90].repeat(8 * 16)
}

fn depth(step: usize) -> Vec<u8> {
    u16::try_from(500 + step).unwrap().to_le_bytes().repeat(8 * 16)
}

/// A foxglove.RawImage as JSON.
fn raw(encoding: &str, pixel_bytes: usize, data: &[u8]) -> Value {
    json!({
        "frame_id": "front", "width": 16, "height": 8, "encoding": encoding, "step": 16 * pixel_bytes,
        "data": STANDARD.encode(data),
    })
}

/// A recording of JSON messages whose color and depth images are those that `image` returns.
fn scene(steps: usize, mut image: impl FnMut(usize) -> (Value, Value)) -> Scene {
    let mut scene = Scene::steps(i64::try_from(steps).unwrap());
    for step in 0..steps {
        let (color, depth) = image(step);
        let ms = 1000 + i64::try_from(step).unwrap() * 100;
        scene.add("/front/color", ms, color);
        scene.add("/front/depth", ms, depth);
    }
    scene
}

fn task() -> TaskSpec {
    arm()
}

#[test]
fn raw_images_in_json_are_base64_text() {
    let reading = scene(6, |step| (raw("rgb8", 3, &color(step)), raw("16UC1", 2, &depth(step)))).read(&task()).unwrap();
    assert_eq!((reading.report.steps, reading.report.findings.as_slice()), (6, &[][..]));
    let expected: Vec<u8> = (0..6).flat_map(|step| [color(step), depth(step)].concat()).collect();
    assert!(reading.episode.frames().as_ref() == expected);
}

/// Robots' observations pass `decode_color` and `decode_depth` too, so a policy is served the pixels that it was trained on.
#[test]
fn recorded_pictures_become_those_of_a_step() {
    let mut spec = task();
    let recorded = RecordedSize { height: 8, width: 16, crop: Some(Crop { top: 1, left: 2, height: 6, width: 12 }) };
    (spec.cameras[0].height, spec.cameras[0].width, spec.cameras[0].recorded) = (3, 5, Some(recorded));
    let colors: Vec<Vec<u8>> = (0..4)
        .map(|step: u8| (0..8 * 16 * 3).map(|at: usize| u8::try_from(at * 5 % 256).unwrap() ^ step).collect())
        .collect();
    let reading = scene(4, |step| (raw("rgb8", 3, &colors[step]), raw("16UC1", 2, &depth(step)))).read(&spec).unwrap();
    assert_eq!(reading.report.findings, []);
    let sizes = spec.cameras[0].sizes();
    let of_step = |step: usize| {
        let color = decode_color(&colors[step], PixelFormat::Rgb8, &sizes).unwrap();
        [color, decode_depth(&depth(step), PixelFormat::Depth16, &sizes).unwrap()].concat()
    };
    let expected: Vec<u8> = (0..4).flat_map(of_step).collect();
    assert_eq!(expected.len(), 4 * 3 * 5 * 5);
    assert!(reading.episode.frames().as_ref() == expected);
}

#[test]
fn compressed_images_in_json_are_base64_text() {
    let image = |step: usize| {
        let jpeg = encode_jpeg(&color(step), 8, 16, 92).unwrap();
        (json!({"format": "jpeg", "data": STANDARD.encode(jpeg)}), raw("16UC1", 2, &depth(step)))
    };
    let reading = scene(4, image).read(&task()).unwrap();
    assert_eq!(reading.report.findings, []);
    let red = f32::from(reading.episode.frames().as_ref()[3 * (8 * 16 * 5)]);
    assert!((red - 15.0).abs() <= 3.0, "{red}");
}

/// As browsers and web tools write pictures, with the fields of an image or without any other.
#[test]
fn pictures_in_json_are_read_from_addresses() {
    let jpeg = encode_jpeg(&color(1), 8, 16, 92).unwrap();
    let png = encode_png(&[200, 10, 10].repeat(8 * 16), 8, 16).unwrap();
    let address = |media: &str, bytes: &[u8]| format!("data:{media};base64,{}", STANDARD.encode(bytes));
    let colors = [
        json!({"data": address("image/jpeg", &jpeg)}),
        json!({"format": "jpeg", "data": address("image/jpeg", &jpeg)}),
        json!({"encoding": "jpeg", "width": 16, "height": 8, "data": address("image/jpeg;q=92", &jpeg)}),
        json!({"data": address("image/png", &png)}),
    ];
    let scene = scene(4, |step| (colors[step].clone(), raw("16UC1", 2, &depth(step))));
    let reading = scene.read(&task()).unwrap();
    assert_eq!((reading.report.steps, reading.report.findings.as_slice()), (4, &[][..]));
    let frames = reading.episode.frames();
    for (step, expected) in [5.0_f32, 5.0, 5.0, 200.0].into_iter().enumerate() {
        let red = f32::from(frames.as_ref()[step * (8 * 16 * 5)]);
        assert!((red - expected).abs() <= 3.0, "{step}: {red}");
    }
    let broken = |step| (json!({"data": "data:image/jpeg;base64,???"}), raw("16UC1", 2, &depth(step)));
    let report = self::scene(4, broken).report(&task());
    let finding = check(&report, Severity::Error, FindingCode::BrokenImage, "/front/color");
    assert!(finding.detail.contains("not base64"), "{}", finding.detail);
}

/// Written by the `mcap` library for Python, with images as PNG and as rows.
#[test]
fn json_images_of_another_writer_are_read() {
    let task = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("differential/task.json")).unwrap();
    let reading = read_episode(&fixture("json_images.mcap"), &serde_json::from_slice(&task).unwrap()).unwrap();
    assert_eq!((reading.report.steps, reading.report.findings.as_slice()), (3, &[][..]));
    let color = |step: u8| (0..8).flat_map(move |row: u8| [step * 7, row * 20, 90].repeat(16));
    let expected: Vec<u8> = (0..3).flat_map(|step| color(step).chain(depth(step.into()))).collect();
    assert!(reading.episode.frames().as_ref() == expected);
}

#[test]
fn text_that_is_not_base64_is_named() {
    let image = |step: usize| (json!({"format": "jpeg", "data": "???"}), raw("16UC1", 2, &depth(step)));
    let report = scene(4, image).report(&task());
    let finding = check(&report, Severity::Error, FindingCode::BrokenImage, "/front/color");
    assert!(finding.detail.contains("not base64"), "{}", finding.detail);
}

#[test]
fn camera_frozen_while_the_robot_moves_is_a_finding() {
    let scene = |color_at: fn(usize) -> usize| {
        scene(45, move |step| (raw("rgb8", 3, &color(color_at(step))), raw("16UC1", 2, &depth(step))))
    };
    assert_eq!(scene(|at| at).report(&task()).findings, []);
    let report = scene(|at| if (10..40).contains(&at) { 10 } else { at }).report(&task());
    let finding = check(&report, Severity::Warning, FindingCode::FrozenCamera, "/front/color");
    assert_eq!(finding.first_step, Some(10));
    assert!(finding.detail.contains("30 steps"), "{}", finding.detail);
    let short = scene(|at| if (10..25).contains(&at) { 10 } else { at }).report(&task());
    assert_eq!(short.findings, []);
}

#[test]
fn a_still_image_of_a_robot_at_rest_has_no_finding() {
    let at_rest = scene(45, |_| (raw("rgb8", 3, &color(3)), raw("16UC1", 2, &depth(3))))
        .change("/joints", |_, _, content| {
            *content = json!({"position": [0.5, 0.5]});
            true
        })
        .change("/tool", |_, _, content| {
            *content = json!({"x": 0.25});
            true
        });
    assert_eq!(at_rest.report(&task()).findings, []);
}

#[test]
fn an_image_that_is_held_is_a_gap_and_not_a_frozen_camera() {
    let mut held = scene(45, |step| (raw("rgb8", 3, &color(step)), raw("16UC1", 2, &depth(step))));
    held.messages.retain(|(topic, stamp, ..)| *topic != "/front/color" || !(2000..5000).contains(&stamp.unwrap()));
    let report = read_bytes(&held.mcap(), &task()).unwrap().report;
    check(&report, Severity::Warning, FindingCode::Gap, "/front/color");
}

#[test]
fn a_size_that_changes_in_the_middle_is_one_finding_at_its_first_step() {
    let half = |step: usize| {
        let small = json!({
            "frame_id": "front", "width": 8, "height": 8, "encoding": "rgb8", "step": 24,
            "data": STANDARD.encode([7; 8 * 8 * 3]),
        });
        (if step < 4 { raw("rgb8", 3, &color(step)) } else { small }, raw("16UC1", 2, &depth(step)))
    };
    let finding = check(&scene(9, half).report(&task()), Severity::Error, FindingCode::WrongSize, "/front/color");
    assert_eq!(finding.first_step, Some(4));
    assert!(finding.detail.contains("8×8") && finding.detail.contains("5 images alike"), "{}", finding.detail);
}

#[test]
fn odd_sizes_are_read_in_every_form() {
    let (height, width) = (7, 13);
    let mut spec = task();
    (spec.cameras[0].height, spec.cameras[0].width) = (height, width);
    let rgb: Vec<u8> = (0..7 * 13 * 3).map(|at| u8::try_from(at % 200).unwrap()).collect();
    let far = 700_u16.to_le_bytes().repeat(7 * 13);
    let of = |encoding: &str, pixel_bytes: usize, data: &[u8]| {
        let step = 13 * pixel_bytes;
        let data = STANDARD.encode(data);
        json!({"frame_id": "f", "width": 13, "height": 7, "encoding": encoding, "step": step, "data": data})
    };
    let jpeg = encode_jpeg(&rgb, height, width, 92).unwrap();
    let colors = [of("rgb8", 3, &rgb), json!({"format": "jpeg", "data": STANDARD.encode(&jpeg)})];
    let reading = scene(2, |step| (colors[step].clone(), of("16UC1", 2, &far))).read(&spec).unwrap();
    assert_eq!(reading.report.findings, []);
    let sizes = spec.cameras[0].sizes();
    let shown = decode_color(&jpeg, PixelFormat::Auto, &sizes).unwrap();
    assert!(reading.episode.frames().as_ref() == [&rgb[..], &far, &shown, &far].concat());
}
