//! Real recordings, where a folder of them exists: they have no errors, and each step is one tick.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::pick_cube;
use crate::{FindingCode, Severity, extract, read_episode};

/// The recordings of one dialect; empty, with a line that the test is skipped, without a folder of them.
fn recordings(folder: &str) -> Vec<PathBuf> {
    let default = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/episodes");
    let root = std::env::var_os("GLEANER_EPISODES").map_or_else(default, PathBuf::from);
    let Ok(entries) = std::fs::read_dir(root.join(folder)) else {
        println!("skipped: no recordings in {}; set GLEANER_EPISODES to their folder", root.display());
        return Vec::new();
    };
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "mcap"));
    paths.sort();
    paths
}

fn check(folder: &str) {
    let spec = pick_cube();
    let begin = Instant::now();
    let (mut steps, mut bytes, mut frozen) = (0, 0, 0);
    let paths = recordings(folder);
    for path in &paths {
        let reading = read_episode(path, &spec).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let report = &reading.report;
        let unexpected = report.findings.iter().find(|finding| finding.code != FindingCode::FrozenJoint);
        assert_eq!(unexpected, None, "{}", path.display());
        assert!(report.findings.iter().all(|finding| finding.severity < Severity::Error));
        frozen += report.findings.len();
        // Every message of every topic belongs to a step of its own.
        assert!(report.topics.iter().all(|topic| topic.used && topic.messages == report.steps), "{}", path.display());
        assert!((report.rate_hz - 20.0).abs() < 0.5, "{}", report.rate_hz);
        // The tool and the goal belong to one tick: goal − tool equals the recorded difference.
        for row in reading.episode.proprioception().chunks_exact(38) {
            for axis in 0..3 {
                let difference = row[32 + axis] - row[25 + axis] - row[35 + axis];
                assert!(difference.abs() < 1e-5, "{}: {difference}", path.display());
            }
        }
        assert!(reading.episode.action().iter().all(|value| value.abs() <= 1.0));
        steps += report.steps;
        bytes += std::fs::metadata(path).unwrap().len();
    }
    if let Some(count) = u32::try_from(paths.len()).ok().filter(|count| *count > 0) {
        let seconds = begin.elapsed().as_secs_f64();
        let megabytes = f64::from(u32::try_from(bytes).unwrap()) / 1e6;
        println!(
            "{folder}: {count} episodes, {steps} steps, {frozen} frozen joints; {:.1} ms an episode, {:.1} MB/s of files, \
             {:.0} MB/s of frames",
            seconds * 1e3 / f64::from(count),
            megabytes / seconds,
            steps as f64 * 163_840.0 / 1e6 / seconds
        );
    }
}

#[test]
fn every_foxglove_recording_reads() {
    check("foxglove");
}

#[test]
fn every_ros2_recording_reads() {
    check("ros2");
}

#[test]
fn a_stretch_of_a_real_recording_reads_as_the_same_steps() {
    let (spec, folder) = (pick_cube(), tempfile::tempdir().unwrap());
    for path in ["foxglove", "ros2"].iter().filter_map(|folder| recordings(folder).pop()) {
        let out = folder.path().join("stretch.mcap");
        let kept = crate::Kept::unscored(7, 6);
        extract(&path, &spec, &kept, &out).unwrap();
        let (whole, part) = (read_episode(&path, &spec).unwrap().episode, read_episode(&out, &spec).unwrap().episode);
        assert_eq!(part.stamps(), &whole.stamps()[7..13]);
        assert_eq!(part.proprioception(), whole.proprioception()[7 * 38..13 * 38]);
        assert_eq!(part.action(), whole.action()[7 * 7..13 * 7]);
        let step = part.frames().as_ref().len() / 6;
        assert_eq!(part.frames().as_ref(), &whole.frames().as_ref()[7 * step..13 * step]);
    }
}
