//! Images of synthetic frames, decoded again.

#![allow(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "tests only")]

use gleaner_recording::{Alignment, PictureSizes, PixelFormat, decode_color};

use super::*;
use crate::error::Kind;

fn spec() -> TaskSpec {
    let camera =
        |name: &str, height, width, depth| CameraSpec { name: name.into(), height, width, depth, recorded: None };
    TaskSpec {
        name: "stack".into(),
        instruction: String::new(),
        openpi: Vec::new(),
        rate_hz: 10.0,
        cameras: vec![camera("front", 8, 16, true), camera("wrist", 6, 10, false)],
        proprioception: Vec::new(),
        action: Vec::new(),
        alignment: Alignment::default(),
        tolerance: 0.25,
        mappings: Vec::new(),
    }
}

/// Smooth colour, as from a camera, and depth that rises from left to right, without a reading in the first column.
fn frame() -> Vec<u8> {
    let color = |height: u8, width: u8, blue: u8| {
        let pixels = (0..height).flat_map(move |row| (0..width).map(move |column| (row, column)));
        pixels.flat_map(move |(row, column)| [row * 8, column * 8, blue]).collect::<Vec<u8>>()
    };
    let depth = (0..8).flat_map(|_| (0..16_u16).flat_map(|column| (column * 100).to_le_bytes()));
    [color(8, 16, 40), depth.collect(), color(6, 10, 200)].concat()
}

fn view(camera: &str) -> FrameView {
    FrameView { step: 0, camera: camera.into(), depth: false, size: None }
}

fn drawn(view: &FrameView, height: u32, width: u32) -> Vec<u8> {
    let jpeg = picture(&spec(), &frame(), view).unwrap();
    decode_color(&jpeg, PixelFormat::Jpeg, &PictureSizes::new(height, width)).unwrap()
}

fn assert_near(found: &[u8], expected: &[u8], within: u8) {
    assert_eq!(found.len(), expected.len());
    let worst = found.iter().zip(expected).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(worst <= Some(within), "{worst:?}");
}

#[test]
fn each_camera_shows_its_own_pixels() {
    let all = frame();
    assert_near(&drawn(&view("front"), 8, 16), &all[..8 * 16 * 3], 16);
    assert_near(&drawn(&view("wrist"), 6, 10), &all[8 * 16 * 5..], 16);
}

#[test]
fn near_is_light_far_is_dark_and_missing_depth_is_black() {
    assert_eq!(grey(&[0, 0, 100, 0, 44, 1]), [0, 0, 0, 255, 255, 255, 32, 32, 32]);
    assert_eq!(grey(&[7, 0, 7, 0]), [255; 6], "all as near");
    assert_eq!(grey(&[0, 0]), [0; 3], "nothing measured");
    let shown = drawn(&FrameView { depth: true, ..view("front") }, 8, 16);
    let row: Vec<u8> = shown.chunks_exact(3).take(16).map(|pixel| pixel[0]).collect();
    assert!(row[15] < 60 && row[2] > 200, "{row:?}");
}

#[test]
fn images_are_scaled_down_by_the_mean_and_never_up() {
    let small = drawn(&FrameView { size: Some(8), ..view("front") }, 4, 8);
    let expected: Vec<u8> =
        (0..4_u8).flat_map(|row| (0..8_u8).flat_map(move |c| [row * 16 + 4, c * 16 + 4, 40])).collect();
    assert_near(&small, &expected, 16);
    // 6 × 10 in squares of 4: the remainder at the edge is dropped.
    drawn(&FrameView { size: Some(3), ..view("wrist") }, 1, 2);
    drawn(&FrameView { size: Some(1), ..view("wrist") }, 1, 1);
    drawn(&FrameView { size: Some(100), ..view("wrist") }, 6, 10);
    let line = Picture { rgb: vec![0, 0, 0, 10, 10, 10, 21, 21, 21], height: 1, width: 3 };
    let one = line.within(1);
    assert_eq!((one.height, one.width, one.rgb), (1, 1, vec![10, 10, 10]));
}

#[test]
fn a_missing_camera_is_named() {
    let fails = |view: &FrameView| picture(&spec(), &frame(), view).unwrap_err();
    let unknown = fails(&view("side"));
    assert_eq!(unknown.kind(), Kind::NotFound);
    assert!(
        unknown.message().starts_with("no camera \"side\"") && unknown.message().contains("front, wrist"),
        "{unknown}"
    );
    let flat = fails(&FrameView { depth: true, ..view("wrist") });
    assert!(flat.kind() == Kind::Invalid && flat.message().starts_with("depth: "), "{flat}");
    let nothing = fails(&FrameView { size: Some(0), ..view("wrist") });
    assert!(nothing.kind() == Kind::Invalid && nothing.message().starts_with("size: "), "{nothing}");
    let blind = TaskSpec { cameras: Vec::new(), ..spec() };
    assert_eq!(picture(&blind, &[], &view("front")).unwrap_err().kind(), Kind::NotFound);
    assert_eq!(picture(&spec(), &frame()[..40], &view("front")).unwrap_err().kind(), Kind::Internal);
}
