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
fn the_same_dataset_gives_the_same_file() {
    assert!(exported(false).read(FILE) == exported(false).read(FILE));
}
