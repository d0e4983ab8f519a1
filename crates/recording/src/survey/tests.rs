//! Tests of the survey, with small scenes and the recordings of the fixtures.

use std::collections::BTreeMap;
use std::path::Path;

use base64::Engine as _;
use serde_json::{Value, json};

use super::*;
use crate::tests::fixture;
use crate::tests::scene::Scene;
use crate::tests::video::Film;
use gleaner_core::{FieldKind, SurveyedField, ValueRange};

fn surveyed(scene: &Scene) -> Survey {
    surveyed_bytes(&scene.mcap(), None)
}

fn surveyed_bytes(bytes: &[u8], pictures: Option<&Path>) -> Survey {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, bytes).unwrap();
    survey(&path, &Limits::default(), pictures).unwrap()
}

fn topic<'a>(survey: &'a Survey, name: &str) -> &'a SurveyedTopic {
    survey.topics.iter().find(|topic| topic.topic == name).unwrap()
}

fn field<'a>(topic: &'a SurveyedTopic, path: &str) -> &'a SurveyedField {
    topic.fields.iter().find(|field| field.path == path).unwrap()
}

#[test]
fn topics_have_rates_gaps_and_field_ranges() {
    // Ten messages a second, then nothing for a second.
    let mut scene = Scene::steps(20);
    scene.add("/joints", 4000, json!({"position": [9.0, -9.0], "mode": "idle"}));
    let found = surveyed(&scene);
    assert_eq!((found.messages, found.duration_ns), (61, 3_000_000_000));
    let joints = topic(&found, "/joints");
    assert_eq!((joints.messages, joints.gaps, joints.longest_interval_ns), (21, 1, 1_100_000_000));
    assert!((joints.rate_hz - 10.0).abs() < 1e-9 && joints.stamped && joints.camera.is_none(), "{joints:?}");
    let position = field(joints, "position");
    assert_eq!((position.kind, position.shortest, position.longest), (FieldKind::Numbers, 2, 2));
    let ranges = [ValueRange { minimum: 0.0, maximum: 9.0 }, ValueRange { minimum: -9.0, maximum: 0.0 }];
    assert_eq!(position.ranges, ranges);
    assert!(position.values.is_empty());
    let mode = field(joints, "mode");
    assert_eq!((mode.kind, mode.messages, mode.text.as_str()), (FieldKind::Text, 1, "idle"));
}

#[test]
fn values_of_a_named_array_follow_their_names() {
    let mut scene = Scene::default();
    scene.add("/joints", 100, json!({"name": ["a", "b"], "position": [1.0, 2.0]}));
    scene.add("/joints", 200, json!({"name": ["b", "a"], "position": [4.0, 3.0]}));
    scene.add("/joints", 300, json!({"name": ["c"], "position": [5.0]}));
    scene.add("/list", 100, json!({"joints": [{"name": "x", "position": 1.0}, {"name": "y", "position": 0.0}]}));
    let found = surveyed(&scene);
    let position = field(topic(&found, "/joints"), "position");
    assert_eq!(position.names, ["a", "b", "c"]);
    let range = |minimum, maximum| ValueRange { minimum, maximum };
    assert_eq!(position.ranges, [range(1.0, 3.0), range(2.0, 4.0), range(5.0, 5.0)]);
    let listed = field(topic(&found, "/list"), "joints.position");
    assert_eq!((listed.names.len(), listed.longest, listed.values.as_slice()), (2, 2, [1.0, 0.0].as_slice()));
}

#[test]
fn arrays_of_varying_length_have_no_ranges() {
    let mut scene = Scene::default();
    scene.add("/a", 100, json!({"v": [1.0], "rows": [[1.0], [2.0]], "empty": []}));
    scene.add("/a", 200, json!({"v": [1.0, 2.0, 3.0], "rows": [[1.0], [2.0]], "empty": []}));
    let found = surveyed(&scene);
    let v = field(topic(&found, "/a"), "v");
    assert!(!v.is_fixed() && v.ranges.is_empty(), "{v:?}");
    assert_eq!(field(topic(&found, "/a"), "rows").kind, FieldKind::Other);
    assert_eq!(field(topic(&found, "/a"), "empty").longest, 0);
}

#[test]
fn recordings_of_both_dialects_show_their_cameras() {
    let folder = tempfile::tempdir().unwrap();
    for (name, color, depth) in [
        ("pick_cube_foxglove.mcap", "/camera/hand/color", "/camera/hand/depth"),
        ("pick_cube_ros2.mcap", "/hand_camera/color/image_raw/compressed", "/hand_camera/depth/image_raw"),
    ] {
        let found = survey(&fixture(name), &Limits::default(), Some(folder.path())).unwrap();
        let camera = |name: &str| topic(&found, name).camera.clone().unwrap();
        let (color, depth) = (camera(color), camera(depth));
        assert_eq!((color.encoding.as_str(), color.depth), ("jpeg", false), "{name}");
        assert_eq!((depth.encoding.as_str(), depth.depth), ("16UC1", true), "{name}");
        assert_eq!((color.height, color.width), (depth.height, depth.width), "{name}");
        assert_eq!((color.other_sizes, color.unreadable, color.problem), (0, 0, None), "{name}");
        for picture in [color.picture.unwrap(), depth.picture.unwrap()] {
            let jpeg = std::fs::read(folder.path().join(&picture)).unwrap();
            assert_eq!(crate::image::header_of(&jpeg).unwrap().size, (color.height, color.width), "{picture}");
        }
    }
    let joints = survey(&fixture("pick_cube_ros2.mcap"), &Limits::default(), None).unwrap();
    let position = field(topic(&joints, "/joint_states"), "position").clone();
    assert_eq!((position.names.len(), position.ranges.len()), (9, 9));
    assert!(topic(&joints, "/joint_states").stamped && !topic(&joints, "/gripper/command").stamped);
}

#[test]
fn video_shows_its_size_and_a_picture() {
    for name in ["h264_main", "h265_main", "av1_aom"] {
        let film = Film::read(name);
        let mut scene = Scene::default();
        for (at, data) in film.messages.iter().enumerate() {
            let data = base64::engine::general_purpose::STANDARD.encode(data);
            let ms = i64::try_from(at).unwrap() * 50;
            scene.add("/front", ms, json!({"format": film.format, "data": data}));
        }
        let folder = tempfile::tempdir().unwrap();
        let found = surveyed_bytes(&scene.mcap(), Some(folder.path()));
        let camera = topic(&found, "/front").camera.clone().unwrap();
        assert_eq!((camera.height, camera.width, camera.problem), (48, 64, None), "{name}");
        assert!(folder.path().join(camera.picture.unwrap()).is_file(), "{name}");
    }
}

#[test]
fn pictures_in_addresses_show_their_size_and_kind() {
    let jpeg = crate::image::encode_jpeg(&[90; 8 * 16 * 3], 8, 16, 92).unwrap();
    let png = crate::image::encode_png(&[90; 8 * 16 * 3], 8, 16).unwrap();
    let mut scene = Scene::default();
    for (topic, media, bytes) in [("/jpeg", "image/jpeg", jpeg), ("/png", "image/png", png)] {
        let data = base64::engine::general_purpose::STANDARD.encode(bytes);
        scene.add(topic, 100, json!({"encoding": "base64", "data": format!("data:{media};base64,{data}")}));
    }
    scene.add("/note", 100, json!({"data": "data: none, so far"}));
    let folder = tempfile::tempdir().unwrap();
    let found = surveyed_bytes(&scene.mcap(), Some(folder.path()));
    for (name, encoding) in [("/jpeg", "jpeg"), ("/png", "png")] {
        let camera = topic(&found, name).camera.clone().unwrap();
        assert_eq!((camera.encoding.as_str(), camera.height, camera.width, camera.problem), (encoding, 8, 16, None));
        assert!(folder.path().join(camera.picture.unwrap()).is_file(), "{name}");
    }
    assert!(topic(&found, "/note").camera.is_none());
}

#[test]
fn depth_in_rvl_shows_its_size_and_a_picture() {
    // 3 × 4 pixels: three zeros, then 500, 501, 499, then zeros.
    let image = [0_u32, 0, 0, 4, 3].map(u32::to_le_bytes).concat();
    let words = [0x338d_f123_u32, 0x6000_0000].map(u32::to_le_bytes).concat();
    let data = base64::engine::general_purpose::STANDARD.encode([image, words].concat());
    let mut scene = Scene::default();
    scene.add("/depth", 100, json!({"format": "16UC1; compressedDepth rvl", "data": data}));
    scene.add("/depth", 200, json!({"format": "16UC1; compressedDepth rvl", "data": "AAAA"}));
    let folder = tempfile::tempdir().unwrap();
    let found = surveyed_bytes(&scene.mcap(), Some(folder.path()));
    let camera = topic(&found, "/depth").camera.clone().unwrap();
    assert_eq!((camera.encoding.as_str(), camera.depth, camera.height, camera.width), ("rvl", true, 3, 4));
    assert!(folder.path().join(camera.picture.unwrap()).is_file());
    assert_eq!(camera.unreadable, 1);
    assert!(camera.problem.unwrap().contains("the RVL ends before its size"));
}

#[test]
fn a_picture_of_another_size_than_the_first_image_has_its_own_size() {
    let mut scene = Scene::default();
    // The first image lacks most of its pixels.
    for (ms, height, width, bytes) in [(100, 64, 96, 9), (200, 8, 16, 8 * 16 * 3)] {
        let data = base64::engine::general_purpose::STANDARD.encode(vec![90; bytes]);
        let image = json!({"encoding": "rgb8", "height": height, "width": width, "step": width * 3, "data": data});
        scene.add("/front", ms, image);
    }
    let folder = tempfile::tempdir().unwrap();
    let found = surveyed_bytes(&scene.mcap(), Some(folder.path()));
    let camera = topic(&found, "/front").camera.clone().unwrap();
    assert_eq!((camera.height, camera.width, camera.other_sizes), (64, 96, 1));
    let picture = std::fs::read(folder.path().join(camera.picture.unwrap())).unwrap();
    assert_eq!(crate::image::header_of(&picture).unwrap().size, (8, 16));
}

#[test]
fn unreadable_images_and_topics_are_named_and_counted() {
    let mut scene = Scene::default();
    for ms in [100, 200] {
        scene.add("/camera/../x", ms, json!({"format": "jpeg", "data": "bm90IGFuIGltYWdl"}));
    }
    let folder = tempfile::tempdir().unwrap();
    let found = surveyed_bytes(&scene.mcap(), Some(folder.path()));
    let camera = topic(&found, "/camera/../x").camera.clone().unwrap();
    assert_eq!((camera.unreadable, camera.height, camera.picture), (2, 0, None));
    assert!(camera.problem.unwrap().contains("neither JPEG"));

    let mut writer = mcap::WriteOptions::new().create(std::io::Cursor::new(Vec::new())).unwrap();
    let channel = writer.add_channel(0, "/odd", "cbor", &BTreeMap::new()).unwrap();
    let header = mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 1, publish_time: 1 };
    writer.write_to_known_channel(&header, b"x").unwrap();
    writer.finish().unwrap();
    let found = surveyed_bytes(&writer.into_inner().into_inner(), None);
    let odd = topic(&found, "/odd");
    assert!(odd.unreadable == 1 && odd.problem.as_ref().unwrap().contains("cbor"), "{odd:?}");
}

#[test]
fn fields_beyond_the_limits_are_left_out_and_marked() {
    let wide: serde_json::Map<String, Value> = (0..2000).map(|at| (format!("f{at}"), json!(at))).collect();
    let mut scene = Scene::default();
    scene.add("/wide", 100, Value::Object(wide));
    scene.add("/long", 100, json!({"v": vec![0.5; 5000]}));
    scene.add("/small", 100, json!({"v": 1.0}));
    let found = surveyed(&scene);
    let (wide, long) = (topic(&found, "/wide"), topic(&found, "/long"));
    assert!(wide.more && wide.fields.len() == 512);
    assert!(long.more && field(long, "v").longest == 5000 && field(long, "v").ranges.len() == 1024);
    assert!(!topic(&found, "/small").more);
}
