//! One real recording of each dialect, compared with values that other libraries calculated.

use serde::Deserialize;

use super::{fixture, pick_cube};
use crate::frame_bytes_per_step;
use crate::read_episode;

#[derive(Deserialize)]
struct Expected {
    stamps: Vec<i64>,
    proprioception: Vec<Vec<f32>>,
    action: Vec<Vec<f32>>,
    /// For each step and camera: the sum and the pixels (0, 0), (64, 64), (100, 17).
    depth_sum_and_pixels: Vec<Vec<[u64; 4]>>,
    /// For each step and camera: red, green, blue.
    color_mean: Vec<Vec<[f64; 3]>>,
}

fn check(name: &str, mapping: &str) {
    let text = std::fs::read_to_string(fixture(&format!("{name}.json"))).unwrap();
    let expected: Expected = serde_json::from_str(&text).unwrap();
    let spec = pick_cube();
    let reading = read_episode(&fixture(&format!("{name}.mcap")), &spec).unwrap();
    assert_eq!(reading.mapping, mapping);
    assert_eq!(reading.report.findings, []);
    assert_eq!(reading.episode.stamps(), expected.stamps);
    assert_eq!(reading.episode.proprioception(), expected.proprioception.concat());
    assert_eq!(reading.episode.action(), expected.action.concat());
    let frames = reading.episode.frames();
    let (pixels, camera_bytes) = (128 * 128, 128 * 128 * 5);
    assert_eq!(frames.as_ref().len(), 6 * frame_bytes_per_step(&spec));
    for (at, camera) in frames.as_ref().chunks_exact(camera_bytes).enumerate() {
        let (step, which) = (at / 2, at % 2);
        let (color, depth) = camera.split_at(pixels * 3);
        let depth: Vec<u64> = depth.as_chunks().0.iter().map(|mm| u64::from(u16::from_le_bytes(*mm))).collect();
        let found = [depth.iter().sum(), depth[0], depth[64 * 128 + 64], depth[100 * 128 + 17]];
        assert_eq!(found, expected.depth_sum_and_pixels[step][which], "depth of step {step}, camera {which}");
        for (channel, mean) in expected.color_mean[step][which].iter().enumerate() {
            let sum: f64 = color.iter().skip(channel).step_by(3).map(|value| f64::from(*value)).sum();
            let found = sum / f64::from(u32::try_from(pixels).unwrap());
            assert!((found - mean).abs() < 0.5, "step {step}, camera {which}, channel {channel}: {found}, {mean}");
        }
    }
}

#[test]
fn foxglove() {
    check("pick_cube_foxglove", "foxglove");
}

#[test]
fn ros2() {
    check("pick_cube_ros2", "ros2");
}

#[test]
fn the_task_has_the_papers_sizes() {
    let spec = pick_cube();
    crate::validate(&spec).unwrap();
    assert_eq!((spec.proprioception_size(), spec.action_size()), (38, 7));
}
