//! Datasets of `fixtures/`, which their own programs wrote, as recordings that are read back.

mod damage;
mod one_of_many;
mod round_trips;

use std::path::{Path, PathBuf};

use gleaner_recording::{Episode, Report, Severity, read_episode};

use super::*;

/// Steps of the two episodes of each fixture.
const LENGTHS: [u64; 2] = [12, 9];

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}

/// The steps of an episode of a dataset, read by the task of its description.
fn steps(dataset: &Path, episode: u64) -> (Episode, Report, Converted) {
    let description = describe(dataset, &Assumed::default()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.mcap");
    let converted = convert(dataset, &Assumed::default(), episode, &out).unwrap();
    let reading = read_episode(&out, &description.spec).unwrap();
    (reading.episode, reading.report, converted)
}

/// The picture that a fixture was made from.
fn image(episode: usize, step: usize) -> Vec<u8> {
    let places = (0..48).flat_map(|row| (0..64).map(move |column| (row, column)));
    let byte = |value: usize| u8::try_from(value % 256).unwrap();
    places
        .flat_map(|(row, column)| [byte(column * 4 + step * 6), byte(row * 5), byte(episode * 90 + step * 7)])
        .collect()
}

/// State and action that a fixture was made from.
fn numbers(episode: u8, step: u8) -> ([f32; 3], [f32; 3]) {
    #[expect(clippy::cast_possible_truncation, reason = "as the fixture's maker rounds it")]
    let value = (f64::from(step) * 0.1 + f64::from(episode)) as f32;
    ([value, -value, 0.5], [value * 0.5, 1.0, -1.0])
}

fn assert_numbers(episode: &Episode, number: u8, case: &str) {
    let (mut state, mut action) = (Vec::new(), Vec::new());
    for step in 0..u8::try_from(episode.steps()).unwrap() {
        let (one, other) = numbers(number, step);
        state.extend(one);
        action.extend(other);
    }
    assert_eq!(episode.proprioception(), state, "{case}");
    assert_eq!(episode.action(), action, "{case}");
}

#[test]
fn names_in_several_lists_have_the_order_of_their_values() {
    let folder = tempfile::tempdir().unwrap();
    damage::copy(&fixture("lerobot_v30_images"), folder.path());
    let path = folder.path().join("meta/info.json");
    let list = serde_json::json!(["shoulder_pan.pos", "elbow_flex.pos", "gripper.pos"]);
    let mut info: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    assert_eq!(info["features"]["observation.state"]["names"], list);
    info["features"]["observation.state"]["names"] = "HERE".into();
    let lists = r#"{"motors": ["shoulder_pan.pos", "elbow_flex.pos"], "gripper": ["gripper.pos"]}"#;
    std::fs::write(&path, info.to_string().replace("\"HERE\"", lists)).unwrap();
    let spec = describe(folder.path(), &Assumed::default()).unwrap().spec;
    let found: Vec<&str> = spec.proprioception.iter().map(|field| field.name.as_str()).collect();
    assert_eq!(found, ["shoulder_pan_pos", "elbow_flex_pos", "gripper_pos"]);
}

#[test]
fn a_dataset_describes_its_task() {
    let description = describe(&fixture("lerobot_v30_images"), &Assumed::default()).unwrap();
    assert_eq!((description.format.as_str(), description.episodes, description.steps), ("LeRobot v3.0", 2, 21));
    let spec = &description.spec;
    let names = |fields: &[gleaner_core::FieldSpec]| fields.iter().map(|field| field.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&spec.proprioception), ["shoulder_pan_pos", "elbow_flex_pos", "gripper_pos"]);
    assert_eq!(names(&spec.action), ["action_shoulder_pan_pos", "action_elbow_flex_pos", "action_gripper_pos"]);
    assert_eq!((spec.rate_hz, spec.cameras[0].name.as_str()), (10.0, "top"));
    assert_eq!((spec.cameras[0].height, spec.cameras[0].width), (48, 64));
    let range = description.fields[3].range.unwrap();
    assert!(range.minimum == 0.0 && (range.maximum - 0.9).abs() < 1e-6, "{range:?}");
    assert!(description.rate_stated && description.left_out.is_empty());

    let description = describe(&fixture("lerobot_v21"), &Assumed::default()).unwrap();
    assert_eq!(description.format, "LeRobot v2.1");
    assert_eq!(description.spec.cameras.len(), 2);
    assert_eq!(description.fields[4].range.unwrap().minimum, 1.0, "statistics of each episode");

    let description = describe(&fixture("robomimic.hdf5"), &Assumed::default()).unwrap();
    assert_eq!((description.episodes, description.steps, description.spec.rate_hz), (2, 21, 10.0));
    assert_eq!(description.environment.as_deref(), Some("Lift"));
    assert_eq!(names(&description.spec.proprioception), ["object", "robot0_eef_pos"]);
    assert_eq!(
        describe(&fixture("robomimic.hdf5"), &Assumed { rate_hz: Some(5.0), ..Assumed::default() })
            .unwrap()
            .spec
            .rate_hz,
        5.0
    );
}

#[test]
fn stored_pictures_and_numbers_are_those_of_the_dataset() {
    for number in 0..2_u8 {
        let (episode, report, converted) = steps(&fixture("lerobot_v30_images"), number.into());
        assert!(report.findings.iter().all(|finding| finding.severity != Severity::Warning), "{:?}", report.findings);
        assert_eq!(converted, Converted { steps: LENGTHS[usize::from(number)], success: Some(number == 0) });
        assert_numbers(&episode, number, "images");
        let frames = episode.frames();
        for (step, frame) in frames.as_ref().chunks(48 * 64 * 3).enumerate() {
            assert!(frame == image(number.into(), step), "step {step}");
        }
    }
}

#[test]
fn pictures_of_video_are_those_that_ffmpeg_decodes() {
    let expected: serde_json::Value =
        serde_json::from_slice(&std::fs::read(fixture("expected.json")).unwrap()).unwrap();
    for name in ["lerobot_v30_video", "lerobot_v21"] {
        for number in 0..2_u8 {
            let (episode, _, converted) = steps(&fixture(name), number.into());
            assert_eq!(converted.steps, LENGTHS[usize::from(number)]);
            assert_numbers(&episode, number, name);
            let cameras = describe(&fixture(name), &Assumed::default()).unwrap().spec.cameras;
            let frames = episode.frames();
            let frames: Vec<&[u8]> = frames.as_ref().chunks(48 * 64 * 3).collect();
            for (at, camera) in cameras.iter().enumerate() {
                let pictures = expected[name][number.to_string()][&camera.name].as_array().unwrap();
                assert_eq!(pictures.len() * cameras.len(), frames.len(), "{name}");
                for (step, pixels) in pictures.iter().enumerate() {
                    let frame = frames[step * cameras.len() + at];
                    for pixel in pixels.as_array().unwrap() {
                        let number = |at: usize| usize::try_from(pixel[at].as_u64().unwrap()).unwrap();
                        let place = (number(0) * 64 + number(1)) * 3;
                        for channel in 0..3 {
                            let difference = usize::from(frame[place + channel]).abs_diff(number(2 + channel));
                            assert!(difference <= 1, "{name} {} step {step}: {pixel} {difference}", camera.name);
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn demonstrations_are_those_of_the_file() {
    for number in 0..2_u8 {
        let (episode, _, converted) = steps(&fixture("robomimic.hdf5"), number.into());
        assert_eq!(converted, Converted { steps: LENGTHS[usize::from(number)], success: Some(number == 0) });
        for step in 0..episode.steps() {
            let (state, action) = numbers(number, u8::try_from(step).unwrap());
            assert_eq!(episode.proprioception()[step * 4..step * 4 + 4], [state[0], state[0], state[1], state[2]]);
            assert_eq!(episode.action()[step * 3..step * 3 + 3], action.map(|value| value * 0.5));
            let frame = &episode.frames().as_ref()[step * 48 * 64 * 3..(step + 1) * 48 * 64 * 3].to_vec();
            assert!(frame == &image(number.into(), step), "step {step}");
        }
    }
}

#[test]
fn a_column_that_is_named_states_the_outcome() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.mcap");
    let by = |column: &str| Assumed { success_column: Some(column.to_owned()), ..Assumed::default() };
    for (name, column, expected) in [
        ("lerobot_v30_images", "next.success", [true, false]),
        ("lerobot_v21", "next.reward", [true, false]),
        // The index of the last row is above zero in both, and the number of the first episode is not.
        ("lerobot_v21", "frame_index", [true, true]),
        ("lerobot_v21", "episode_index", [false, true]),
        ("robomimic.hdf5", "dones", [true, true]),
        ("robomimic.hdf5", "rewards", [true, false]),
    ] {
        for (episode, success) in (0..).zip(expected) {
            let converted = convert(&fixture(name), &by(column), episode, &out).unwrap();
            assert_eq!(converted.success, Some(success), "{name} {column} {episode}");
        }
    }
    for (name, known) in [("lerobot_v21", "next.reward"), ("robomimic.hdf5", "dones, rewards")] {
        // Neither is there, nor has one number a step.
        for column in ["succes", "action", "actions"] {
            let error = describe(&fixture(name), &by(column)).unwrap_err().to_string();
            assert!(error.contains(column) && error.contains(known) && error.contains(name), "{error}");
        }
    }
}

#[test]
fn everything_else_is_kept_beside_the_steps() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.mcap");
    convert(&fixture("lerobot_v21"), &Assumed::default(), 0, &out).unwrap();
    let survey = gleaner_recording::survey(&out, &gleaner_recording::Limits::default(), None).unwrap();
    let frame = survey.topics.iter().find(|topic| topic.topic == "/dataset/frame").unwrap();
    let field = |path: &str| frame.fields.iter().find(|field| field.path == path).unwrap();
    assert_eq!((frame.messages, field("task").text.as_str()), (12, "pick the cube"));
    assert_eq!(field("next.reward").values, [0.0, 1.0]);
    convert(&fixture("robomimic.hdf5"), &Assumed::default(), 1, &out).unwrap();
    let survey = gleaner_recording::survey(&out, &gleaner_recording::Limits::default(), None).unwrap();
    let frame = survey.topics.iter().find(|topic| topic.topic == "/dataset/frame").unwrap();
    let paths: Vec<&str> = frame.fields.iter().map(|field| field.path.as_str()).collect();
    assert_eq!(paths, ["actions", "dones", "rewards", "states"]);
}

#[test]
fn the_same_episode_gives_the_same_bytes_wherever_it_lies() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for name in ["lerobot_v30_images", "lerobot_v30_video", "lerobot_v21", "robomimic.hdf5"] {
        let copy = at(name);
        damage::copy(&fixture(name), &copy);
        convert(&fixture(name), &Assumed::default(), 1, &at("one")).unwrap();
        convert(&copy, &Assumed::default(), 1, &at("two")).unwrap();
        assert!(std::fs::read(at("one")).unwrap() == std::fs::read(at("two")).unwrap(), "{name}");
    }
    let beyond = convert(&fixture("lerobot_v21"), &Assumed::default(), 2, &at("one")).unwrap_err().to_string();
    assert!(beyond.contains("no episode 2") && !at("one").exists(), "{beyond}");
}

#[test]
fn a_file_without_demonstrations_of_robomimic_is_of_another_program() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.h5");
    let mut bytes = std::fs::read(fixture("robomimic.hdf5")).unwrap();
    for at in 0..bytes.len() - 5 {
        if bytes[at..].starts_with(b"demo_") {
            bytes[at..at + 4].copy_from_slice(b"item");
        }
    }
    for (name, lack) in [("data\0", "\"item_0\" and no demo_N"), ("dato\0", "no group `data`")] {
        let at = bytes.windows(5).position(|window| window == b"data\0").unwrap();
        bytes[at..at + 5].copy_from_slice(name.as_bytes());
        std::fs::write(&path, &bytes).unwrap();
        let error = describe(&path, &Assumed::default()).unwrap_err();
        let Undescribed::OtherProgram(refused) = &error else { panic!("{name}: {error}") };
        assert!(refused.contains(lack) && refused.contains("no HDF5 file of robomimic"), "{refused}");
        let refused = convert(&path, &Assumed::default(), 0, &folder.path().join("out.mcap")).unwrap_err().to_string();
        assert_eq!(refused, error.to_string());
    }
}

#[test]
fn a_damaged_file_is_not_one_of_another_program() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.hdf5");
    let whole = std::fs::read(fixture("robomimic.hdf5")).unwrap();
    let without = |part: &[u8]| {
        let at = whole.windows(part.len()).position(|window| window == part).unwrap();
        [&whole[..at], &vec![b'?'; part.len()], &whole[at + part.len()..]].concat()
    };
    let mut damaged = vec![Vec::new(), b"none".to_vec(), without(b"\x89HDF"), without(b"TREE"), without(b"SNOD")];
    damaged.extend((0..20).map(|part| whole[..whole.len() * part / 20].to_vec()));
    for (case, bytes) in damaged.iter().enumerate() {
        std::fs::write(&path, bytes).unwrap();
        let error = describe(&path, &Assumed::default()).unwrap_err();
        assert!(matches!(error, Undescribed::Problem(Problem::Unfit(_))), "{case}: {error}");
    }
}
