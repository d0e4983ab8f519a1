//! The file as its readers find it.

use gleaner_core::dataset::{ExportFormat, ExportSpec};

use super::*;
use crate::testing::Lab;

fn exported(depth: bool) -> Lab {
    let mut lab = Lab::new();
    crate::write(ExportSpec { format: ExportFormat::Robomimic, depth, ..ExportSpec::default() }, &mut lab).unwrap();
    lab
}

#[test]
fn each_piece_is_a_demonstration_with_its_steps() {
    let lab = exported(true);
    assert_eq!(lab.files, [FILE]);
    let file = File::open(lab.out.path().join(FILE)).unwrap();
    let floats = |path: &str| file.dataset(path).unwrap().read_f32().unwrap();
    for (demo, steps) in [("demo_0", 8), ("demo_1", 6), ("demo_2", 3), ("demo_3", 2)] {
        let shape = |name: &str| file.dataset(&format!("data/{demo}/{name}")).unwrap().shape().unwrap();
        assert_eq!(shape("actions"), [steps, 2], "{demo}");
        assert_eq!(shape("obs/front_image"), [steps, 12, 16, 3], "{demo}");
        assert_eq!(shape("next_obs/front_depth"), [steps, 12, 16, 1], "{demo}");
    }
    assert_eq!(floats("data/demo_2/obs/joints"), [2.0, -2.0, 3.0, -3.0, 4.0, -4.0]);
    assert_eq!(floats("data/demo_2/next_obs/joints"), [3.0, -3.0, 4.0, -4.0, 4.0, -4.0]);
    assert_eq!(floats("data/demo_2/weights"), [0.9, 0.8, 0.95]);
    assert_eq!(floats("data/demo_3/weights"), [0.0, 0.7]);
    assert_eq!(floats("data/demo_0/rewards")[6..], [0.0, 1.0]);
    assert_eq!(floats("data/demo_2/rewards"), [0.0; 3]);
    let step = gleaner_recording::frame_bytes_per_step(lab.task());
    let image = file.dataset("data/demo_2/obs/front_image").unwrap().read_u8().unwrap();
    assert!(image[..12 * 16 * 3] == lab.episode(2).frames().as_ref()[2 * step..2 * step + 12 * 16 * 3]);
    let mask = |key: &str| file.dataset(&format!("mask/{key}")).unwrap().read_string().unwrap();
    assert_eq!(mask("experts"), ["demo_0", "demo_1"]);
    assert_eq!(mask("kept"), ["demo_2", "demo_3"]);
    assert!(file.dataset("mask/valid").is_err());
}

#[test]
fn actions_beyond_one_are_rescaled_by_their_range() {
    let range = ActionRange { low: vec![-1.0, 0.0], high: vec![1.0, 4.0] };
    assert_eq!(range.rescaled(&[0.5, 0.0, -0.25, 4.0, 0.0, 1.0]), [0.5, -1.0, -0.25, 1.0, 0.0, -0.5]);
}

#[test]
fn the_pictures_after_a_step_are_those_of_the_next_and_the_last_repeat() {
    let lab = exported(true);
    let file = File::open(lab.out.path().join(FILE)).unwrap();
    let step = gleaner_recording::frame_bytes_per_step(lab.task());
    let (episode, pixels) = (lab.episode(2), 12 * 16);
    let frames = episode.frames();
    // The first camera has depth behind its color, the second color alone.
    for (name, place) in [("front_image", 0..3 * pixels), ("hand_image", 5 * pixels..8 * pixels)] {
        let row = |at: usize| frames.as_ref()[at * step + place.start..at * step + place.end].to_vec();
        let read = |group: &str| file.dataset(&format!("data/demo_2/{group}/{name}")).unwrap().read_u8().unwrap();
        assert!(read("obs") == [row(2), row(3), row(4)].concat(), "{name}");
        assert!(read("next_obs") == [row(3), row(4), row(4)].concat(), "{name}");
    }
    let metres = |at: usize| -> Vec<f32> {
        let mm = frames.as_ref()[at * step + 3 * pixels..at * step + 5 * pixels].as_chunks().0;
        mm.iter().map(|&pair| f32::from(u16::from_le_bytes(pair)) / 1000.0).collect()
    };
    let read = |group: &str| file.dataset(&format!("data/demo_2/{group}/front_depth")).unwrap().read_f32().unwrap();
    assert_eq!(read("obs"), [metres(2), metres(3), metres(4)].concat());
    assert_eq!(read("next_obs"), [metres(3), metres(4), metres(4)].concat());
}

#[test]
fn an_episode_whose_pictures_do_not_fit_into_memory_is_refused() {
    let lab = Lab::new();
    let mut task = lab.task().clone();
    let check = |task: &TaskSpec, depth| check_lengths(lab.pieces(), task, depth);
    assert!(check(&task, true).is_ok());
    (task.cameras[0].height, task.cameras[0].width) = (16_384, 12_800);
    let refused = check(&task, false).unwrap_err().to_string();
    for part in ["has 8 steps", "at most 3 with 16384×12800 pixels", "--format lerobot"] {
        assert!(refused.contains(part), "{refused}");
    }
    assert!(check(&task, true).unwrap_err().to_string().contains("at most 2 with"), "depth has four bytes a pixel");
    task.cameras.clear();
    assert!(check(&task, true).is_ok());
}

#[test]
fn the_same_dataset_gives_the_same_file() {
    assert!(exported(false).read(FILE) == exported(false).read(FILE));
}
