//! Round trips: what is exported here and imported again has the same steps.

use gleaner_core::dataset::{ExportFormat, ExportSpec};

use super::*;
use crate::export::Export as _;
use crate::lerobot::{self, FileSizes};
use crate::testing::Lab;

fn exported(format: ExportFormat) -> Lab {
    let mut lab = Lab::new();
    crate::write(ExportSpec { format, depth: true, ..ExportSpec::default() }, &mut lab).unwrap();
    lab
}

#[test]
fn lerobot_there_and_back_has_the_same_steps() {
    let lab = exported(ExportFormat::Lerobot);
    let description = describe(lab.out.path(), &Assumed::default()).unwrap();
    let task = lab.task();
    assert_eq!(description.spec.proprioception, task.proprioception);
    assert_eq!(description.spec.action, task.action);
    assert_eq!(description.spec.instruction, task.instruction);
    assert_eq!(description.spec.cameras, task.cameras);
    assert_eq!(description.spec.mappings, task.mappings, "the task that made the recordings reads them again");
    for (at, piece) in lab.pieces().iter().enumerate() {
        let (back, report, converted) = steps(lab.out.path(), at as u64);
        let original = lab.episode(at);
        assert_eq!(converted.steps, piece.len() as u64);
        assert_eq!(converted.success, Some(at < 2));
        assert_eq!(report.findings, [], "episode {at}");
        let part = |values: &[f32], size: usize| values[piece.steps.start * size..piece.steps.end * size].to_vec();
        assert_eq!(back.proprioception(), part(&original.proprioception(), 3));
        assert_eq!(back.action(), part(&original.action(), 2));
        let frame = gleaner_recording::frame_bytes_per_step(task);
        let (back, original) = (back.frames(), original.frames());
        assert!(
            back.as_ref() == &original.as_ref()[piece.steps.start * frame..piece.steps.end * frame],
            "episode {at}"
        );
    }
}

#[test]
fn video_there_and_back_has_the_picture_of_each_step() {
    let spec = ExportSpec { format: ExportFormat::Lerobot, depth: true, video: true, whole: false };
    let [mut lab, mut again] = [Lab::smooth(), Lab::smooth()];
    crate::write(spec, &mut lab).unwrap();
    crate::write(spec, &mut again).unwrap();
    assert!(lab.files.iter().filter(|name| name.ends_with(".mp4")).count() == 2, "{:?}", lab.files);
    assert!(lab.files.iter().all(|name| lab.read(name) == again.read(name)), "the same dataset is the same bytes");
    let task = lab.task();
    assert_eq!(describe(lab.out.path(), &Assumed::default()).unwrap().spec.cameras, task.cameras);
    let (frame, color) = (gleaner_recording::frame_bytes_per_step(task), 32 * 48 * 3);
    for (at, piece) in lab.pieces().iter().enumerate() {
        let (back, report, converted) = steps(lab.out.path(), at as u64);
        assert_eq!((converted.steps, report.findings.as_slice()), (piece.len() as u64, [].as_slice()), "{at}");
        let (back, original) = (back.frames(), lab.episode(at).frames());
        let (back, original) = (back.as_ref(), original.as_ref());
        for (step, of) in piece.steps.clone().enumerate() {
            let (found, wanted) = (&back[step * frame..][..frame], &original[of * frame..][..frame]);
            // The color and depth of the first camera, and the color of the second.
            for camera in [0..color, color / 3 * 5..frame] {
                let ratio = signal_to_noise(&found[camera.clone()], &wanted[camera]);
                assert!(ratio > 34.0, "episode {at}, step {step}: {ratio:.1} dB");
            }
            assert!(found[color..color / 3 * 5] == wanted[color..color / 3 * 5], "depth is exact");
        }
    }
}

#[test]
fn episodes_in_files_of_their_own_have_the_same_steps() {
    const LARGE: u64 = 1 << 30;
    let spec = ExportSpec { format: ExportFormat::Lerobot, depth: true, video: true, whole: false };
    let mut one = Lab::smooth();
    crate::write(spec, &mut one).unwrap();
    let count = |lab: &Lab, ending: &str| lab.files.iter().filter(|name| name.ends_with(ending)).count();
    let (tables, films) = (count(&one, ".parquet"), count(&one, ".mp4"));
    for (data, video) in [(1, 1), (1, LARGE), (LARGE, 1)] {
        let mut lab = Lab::smooth();
        lerobot::write_files(&mut lab, spec, FileSizes { data, video }).unwrap();
        let episodes = lab.pieces().len();
        let expected =
            |size: u64, files: usize, each: usize| if size == 1 { files + each * (episodes - 1) } else { files };
        assert_eq!(count(&lab, ".parquet"), expected(data, tables, 1), "{:?}", lab.files);
        assert_eq!(count(&lab, ".mp4"), expected(video, films, films), "{:?}", lab.files);
        for at in 0..episodes as u64 {
            let (found, report, converted) = steps(lab.out.path(), at);
            let (wanted, ..) = steps(one.out.path(), at);
            assert_eq!((converted.steps, report.findings.as_slice()), (wanted.steps() as u64, [].as_slice()), "{at}");
            assert_eq!(found.proprioception(), wanted.proprioception(), "{at}");
            assert_eq!(found.action(), wanted.action(), "{at}");
            // The encoder sees other neighbours at the beginning of a file.
            let ratio = signal_to_noise(found.frames().as_ref(), wanted.frames().as_ref());
            assert!(ratio > 34.0, "episode {at}: {ratio:.1} dB");
        }
    }
}

/// Peak signal to noise ratio in decibels. Pictures of neighbouring steps have 22.
fn signal_to_noise(found: &[u8], wanted: &[u8]) -> f64 {
    let squares: f64 = found.iter().zip(wanted).map(|(one, other)| f64::from(one.abs_diff(*other)).powi(2)).sum();
    10.0 * (255.0_f64.powi(2) * found.len() as f64 / squares).log10()
}

#[test]
fn jpeg_files_are_copied_bit_for_bit() {
    let lab = exported(ExportFormat::Lerobot);
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.mcap");
    convert(lab.out.path(), &Assumed::default(), 0, &out).unwrap();
    let jpegs = |path: &Path| {
        let spool = tempfile::tempfile().unwrap();
        gleaner_recording::StepJpegs::read(path, lab.task(), &(0..8), spool).unwrap()
    };
    let (there, back) = (jpegs(&lab.recording(0).unwrap()), jpegs(&out));
    for step in 0..8 {
        let bytes = back.get(1, step).unwrap().unwrap();
        assert!(bytes == there.get(1, step).unwrap().unwrap(), "step {step}");
    }
}

#[test]
fn robomimic_there_and_back_has_the_same_steps() {
    let lab = exported(ExportFormat::Robomimic);
    let dataset = lab.out.path().join("dataset.hdf5");
    let description = describe(&dataset, &Assumed::default()).unwrap();
    assert_eq!((description.spec.rate_hz, description.rate_stated), (10.0, true));
    assert_eq!(description.spec.cameras, lab.task().cameras);
    for (at, piece) in lab.pieces().iter().enumerate() {
        let (back, _, converted) = steps(&dataset, at as u64);
        let original = lab.episode(at);
        assert_eq!((converted.steps, converted.success), (piece.len() as u64, Some(at < 2)));
        for step in 0..back.steps() {
            let from = piece.steps.start + step;
            // Observations are sorted by their names: gripper, joints.
            let [first, second, gripper] = original.proprioception()[from * 3..from * 3 + 3] else {
                panic!("no state")
            };
            assert_eq!(back.proprioception()[step * 3..step * 3 + 3], [gripper, first, second]);
        }
        assert_eq!(back.action(), &original.action()[piece.steps.start * 2..piece.steps.end * 2], "episode {at}");
        let frame = gleaner_recording::frame_bytes_per_step(lab.task());
        let (back, original) = (back.frames(), original.frames());
        assert!(
            back.as_ref() == &original.as_ref()[piece.steps.start * frame..piece.steps.end * frame],
            "episode {at}"
        );
    }
}
