//! Maps as openpi's example clients send them, and maps that do not fit.

use gleaner_core::{OpenpiKey, RecordedSize};
use proptest::prelude::*;

use super::*;
use crate::array::tests::packed;

fn task(cameras: &[&str], fields: &[(&str, u32)]) -> TaskSpec {
    let camera = |name: &&str| CameraSpec { name: (*name).into(), height: 2, width: 4, depth: false, recorded: None };
    let field = |(name, size): &(&str, u32)| FieldSpec::new(*name, *size);
    TaskSpec {
        name: "stack".into(),
        instruction: String::new(),
        openpi: Vec::new(),
        rate_hz: 10.0,
        cameras: cameras.iter().map(camera).collect(),
        proprioception: fields.iter().map(field).collect(),
        action: Vec::new(),
        alignment: gleaner_core::Alignment::default(),
        tolerance: 0.5,
        mappings: Vec::new(),
    }
}

fn map(entries: Vec<(&str, Value)>) -> Value {
    Value::Map(entries.into_iter().map(|(key, value)| (Value::from(key), value)).collect())
}

fn bytes(value: &Value) -> Vec<u8> {
    let mut message = Vec::new();
    rmpv::encode::write_value(&mut message, value).unwrap();
    message
}

fn floats(values: &[f64]) -> Value {
    packed("<f8", &[values.len()], &values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>())
}

fn image() -> Value {
    packed("|u1", &[2, 4, 3], &(0..24).collect::<Vec<_>>())
}

fn raw(frame: &CameraFrame) -> Vec<u8> {
    frame.color.as_ref().unwrap().data.to_vec()
}

#[test]
fn droid_names_each_field() {
    let task = task(&["exterior_image_1_left", "wrist_image_left"], &[("joint_position", 2), ("gripper_position", 1)]);
    let message = map(vec![
        ("observation/exterior_image_1_left", image()),
        ("observation/wrist_image_left", image()),
        ("observation/joint_position", floats(&[0.5, -1.0])),
        ("observation/gripper_position", Value::from(0.25)),
        ("prompt", Value::from("pick the cube")),
    ]);
    let read = request(&bytes(&message), &task).unwrap();
    assert_eq!((read.proprioception, read.reset), (vec![0.5, -1.0, 0.25], false));
    assert_eq!(
        read.cameras.iter().map(|frame| frame.camera.as_str()).collect::<Vec<_>>(),
        ["exterior_image_1_left", "wrist_image_left"]
    );
    assert_eq!(raw(&read.cameras[0]), (0..24).collect::<Vec<u8>>());
}

#[test]
fn aloha_nests_its_images_channel_by_channel() {
    let planes: Vec<u8> = (0..3).flat_map(|channel| (0..8).map(move |pixel| channel * 100 + pixel)).collect();
    let images = map(vec![("cam_high", packed("|u1", &[3, 2, 4], &planes))]);
    let message = map(vec![("state", floats(&[1.0; 14])), ("images", images), ("reset", Value::Boolean(true))]);
    let read = request(&bytes(&message), &task(&["cam_high"], &[("qpos", 14)])).unwrap();
    assert!(read.reset);
    assert_eq!(raw(&read.cameras[0])[..6], [0, 100, 200, 1, 101, 201]);
}

#[test]
fn libero_is_read_by_the_keys_of_the_task() {
    let mut task = task(&["front", "hand"], &[("pose", 6), ("gripper", 2)]);
    let given = |name: &str, key: &str| OpenpiKey { name: name.into(), key: key.into() };
    task.openpi = vec![given("front", "observation/image"), given("hand", "wrist_image")];
    let wrist = packed("|u1", &[2, 4, 3], &[9; 24]);
    let sent = |front: &str, state: Vec<(&'static str, Value)>| {
        let mut entries = vec![(front, image()), ("observation/wrist_image", wrist.clone())];
        entries.extend(state);
        entries.push(("prompt", Value::from("put the bowl on the plate")));
        bytes(&map(entries))
    };
    let state = || vec![("observation/state", floats(&[0.5; 8]))];
    let read = request(&sent("observation/image", state()), &task).unwrap();
    assert_eq!((raw(&read.cameras[0])[23], raw(&read.cameras[1])[23]), (23, 9));
    assert_eq!(read.proprioception, [0.5; 8]);
    let error = request(&sent("observation/front", state()), &task).unwrap_err();
    let words = "observation/image: is missing; the message has front, wrist_image, state, prompt; if the client names";
    assert!(error.message().starts_with(words), "{error}");

    task.openpi.push(given("gripper", "observation/gripper/width"));
    let apart = vec![("pose", floats(&[1.0; 6])), ("observation", map(vec![("gripper/width", floats(&[2.0, 3.0]))]))];
    let read = request(&sent("image", apart), &task).unwrap();
    assert_eq!(read.proprioception, [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 2.0, 3.0]);
    let error = request(&sent("image", state()), &task).unwrap_err();
    assert!(error.message().starts_with("observation/pose: is missing"), "each field has its own key: {error}");
}

#[test]
fn encoded_depth_and_recorded_pictures_are_read() {
    let mut task = task(&["hand"], &[("x", 1)]);
    task.cameras[0].depth = true;
    task.cameras[0].recorded = Some(RecordedSize { height: 4, width: 8, crop: None });
    let message = |color: Value| {
        let depth = packed("<u2", &[2, 4], &[7; 16]);
        bytes(&map(vec![("hand", color), ("hand_depth", depth), ("state", Value::Array(vec![Value::from(2)]))]))
    };
    let recorded = packed("|u1", &[4, 8, 3], &[9; 96]);
    let read = request(&message(recorded), &task).unwrap();
    assert_eq!((raw(&read.cameras[0]).len(), read.proprioception), (96, vec![2.0]));
    assert_eq!(read.cameras[0].depth.as_ref().unwrap().data.len(), 16);
    let encoded = request(&message(Value::Binary(vec![0xFF, 0xD8, 1])), &task).unwrap();
    assert_eq!(encoded.cameras[0].color.as_ref().unwrap().format, ImageFormat::Any);
}

#[test]
fn what_does_not_fit_is_named() {
    let task = task(&["hand"], &[("joints", 2)]);
    let state = || ("observation/state", floats(&[0.0, 0.0]));
    let cases = [
        (map(vec![state()]), "observation/hand: is missing; the message has state"),
        (
            map(vec![("hand", packed("|u1", &[2, 3, 3], &[0; 18])), state()]),
            "observation/hand: has shape [2, 3, 3]; send uint8 of 2×4×3",
        ),
        (map(vec![("hand", packed("<f4", &[2, 4, 3], &[0; 96])), state()]), "observation/hand: has shape [2, 4, 3]"),
        (map(vec![("hand", Value::from("x")), state()]), "observation/hand: must be an array"),
        (map(vec![("hand", image())]), "observation/joints: is missing; send observation/state (joints 2)"),
        (map(vec![("hand", image()), ("state", floats(&[0.0]))]), "observation/state: has 1 values, the task has 2"),
        (map(vec![("hand", image()), ("state", Value::from("x"))]), "observation/state: must be"),
        (Value::from(3), "message: must be one msgpack map"),
    ];
    for (message, words) in cases {
        let error = request(&bytes(&message), &task).unwrap_err();
        assert!(error.message().starts_with(words), "{error}");
    }
    for broken in [&b"\xc1"[..], b"", &bytes(&map(vec![state()]))[..9]] {
        let error = request(broken, &task).unwrap_err();
        assert!(error.message().starts_with("message: "), "{error}");
    }
}

#[test]
fn nesting_without_end_is_refused() {
    let deep = [[0x81, 0xA1, b'a'].repeat(100_000), vec![0xC0]].concat();
    assert!(request(&deep, &task(&[], &[])).is_err());
}

#[test]
fn a_full_observation_is_below_the_limit() {
    let task = task(&["hand"], &[("joints", 2)]);
    let message = bytes(&map(vec![("hand", image()), ("state", floats(&[0.0, 0.0]))]));
    assert!(message.len() < largest_request(&task));
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(message in proptest::collection::vec(any::<u8>(), 0..200)) {
        let _ = request(&message, &task(&["hand"], &[("joints", 2)]));
    }

    #[test]
    fn any_change_of_a_message_is_read_or_refused(at in 0_usize..150, to in any::<u8>()) {
        let mut message = bytes(&map(vec![("hand", image()), ("state", floats(&[0.0, 0.0]))]));
        let at = at % message.len();
        message[at] = to;
        let _ = request(&message, &task(&["hand"], &[("joints", 2)]));
    }
}
