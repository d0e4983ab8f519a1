//! Runs of neighbouring episodes: what they have in common is read once, and each is as if it were converted alone.

use std::cell::Cell;
use std::ops::Range;

use super::*;

/// The recordings of a run, or the errors; `after` is called after each episode with the bytes of all, and ends the run.
fn run(dataset: &Path, episodes: Range<u64>, after: impl Fn(u64) -> bool) -> Vec<Result<Vec<u8>, String>> {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let results = convert_run(dataset, &Assumed::default(), episodes.clone(), &out, after).unwrap();
    let read = |(result, episode): (Result<_, Problem>, u64)| {
        let file = run_file(&out, episode);
        assert_eq!(file.exists(), result.is_ok(), "{result:?}");
        result.map(|_| fs::read(file).unwrap()).map_err(|error| error.to_string())
    };
    results.into_iter().zip(episodes).map(read).collect()
}

/// The same episodes, each converted alone.
fn alone(dataset: &Path, episodes: Range<u64>) -> Vec<Result<Vec<u8>, String>> {
    episodes.map(|episode| converted(dataset, episode)).collect()
}

#[test]
fn footers_are_read_once_for_a_run() {
    let dataset = Made { in_file: 100, ..MADE }.write();
    let dataset = dataset.path();
    let expected = alone(dataset, 2..9);
    let tables = [EPISODES, TASKS, "data/file-000.parquet"].map(|name| dataset.join(name));
    // Every footer is gone once the first episode is there: a table whose footer is read again is damaged.
    let cut = |_| {
        for table in &tables {
            let mut bytes = fs::read(table).unwrap();
            let footer = bytes.len() - 8;
            bytes[footer..].fill(0);
            fs::write(table, bytes).unwrap();
        }
        false
    };
    let found = run(dataset, 2..9, cut);
    assert!(found == expected && found.iter().all(Result::is_ok), "{:?}", found.iter().find(|one| one.is_err()));
    assert!(converted(dataset, 3).unwrap_err().contains("the table is damaged"));
}

#[test]
fn the_tables_of_a_video_are_read_once_for_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let name = "videos/observation.images.top/chunk-000/file-000.mp4";
    copy_all(&fixture("lerobot_v30_video"), folder.path());
    let video = folder.path().join(name);
    let expected = alone(folder.path(), 0..2);
    let bytes = fs::read(&video).unwrap();
    let at = bytes.windows(4).rposition(|window| window == b"moov").unwrap();
    let cut = |_| {
        let mut bytes = bytes.clone();
        bytes[at..at + 4].copy_from_slice(b"none");
        fs::write(&video, bytes).unwrap();
        false
    };
    assert!(run(folder.path(), 0..2, cut) == expected);
    assert!(expected.iter().all(Result::is_ok) && converted(folder.path(), 1).unwrap_err().contains("the video"));
}

fn copy_all(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let to = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy_all(&path, &to);
        } else {
            fs::copy(&path, &to).unwrap();
        }
    }
}

#[test]
fn episodes_of_a_run_have_the_bytes_of_those_converted_alone() {
    for made in layouts().map(|(_, made)| made).into_iter().chain([Made { version: "v2.1", ..MADE }]) {
        let dataset = made.write();
        if made.version != "v3.0" {
            for episode in 0..12 {
                MADE.data(&dataset.path().join(format!("data/episode_{episode:06}.parquet")), episode..episode + 1);
            }
        }
        for episodes in [0..12, 3..8, 11..14] {
            let (found, expected) =
                (run(dataset.path(), episodes.clone(), |_| false), alone(dataset.path(), episodes.clone()));
            assert!(found == expected, "{made:?}, {episodes:?}");
            let there = found.iter().filter(|one| one.is_ok()).count();
            assert_eq!(there, episodes.filter(|episode| *episode < 12).count(), "{made:?}");
        }
    }
    for name in ["lerobot_v30_video", "lerobot_v30_images", "lerobot_v21", "robomimic.hdf5"] {
        assert!(run(&fixture(name), 0..2, |_| false) == alone(&fixture(name), 0..2), "{name}");
    }
}

#[test]
fn a_damaged_episode_of_a_run_does_not_keep_its_neighbours_from_being_converted() {
    for (name, kept) in [(EPISODES, 8), (TASKS, 8), ("data/file-001.parquet", 3)] {
        let dataset = MADE.write();
        let whole = converted(dataset.path(), 8).unwrap();
        damage_others(&dataset.path().join(name), kept);
        let found = run(dataset.path(), 6..10, |_| false);
        assert!(found[2].as_ref() == Ok(&whole), "{name}: {:?}", found[2].as_ref().err());
        for at in [0, 1, 3] {
            let error = found[at].as_ref().unwrap_err();
            assert!(error.contains("the table is damaged"), "{name}, {at}: {error}");
        }
    }
}

#[test]
fn a_run_ends_after_enough_bytes_and_before_a_full_disk() {
    let dataset = MADE.write();
    let dataset = dataset.path();
    let expected = alone(dataset, 0..3);
    let bytes =
        |episodes: usize| expected[..episodes].iter().map(|one| one.as_ref().unwrap().len() as u64).sum::<u64>();
    let (all, two) = (Cell::new(0), bytes(2));
    let enough = |bytes| {
        all.set(bytes);
        bytes >= two
    };
    assert!(run(dataset, 0..12, enough) == expected[..2]);
    assert_eq!(all.get(), two);
    assert_eq!(run(dataset, 0..12, |_| true).len(), 1, "at least one");

    // A folder in place of the third recording: its file cannot be made.
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(run_file(folder.path(), 2)).unwrap();
    let converted = |episodes| convert_run(dataset, &Assumed::default(), episodes, folder.path(), |_| false).unwrap();
    assert!(converted(0..12).iter().map(|one| one.is_ok()).eq([true; 2]), "the run ends before it");
    let results = converted(2..4);
    assert!(matches!(results.as_slice(), [Err(Problem::Io { .. }), Ok(_)]), "{results:?}");
}
