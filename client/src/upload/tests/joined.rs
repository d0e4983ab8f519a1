//! A recording in parts is sent as one, also when its stream breaks.

use std::path::PathBuf;

use gleaner_recording::{EpisodeWriter, StepRef, TaskSpec, join};

use super::*;
use crate::push::PushItem;

const SIZE: u16 = 256;

/// A folder of parts whose values do not compress: about 1.4 MB each.
fn parts(count: i64) -> tempfile::TempDir {
    let spec: TaskSpec = toml::from_str(&format!(
        "name = \"noise\"\nrate_hz = 10\nproprioception = [{{ name = \"p\", size = {SIZE} }}]\naction = [{{ name = \"a\", size \
         = 1 }}]\nmappings = []"
    ))
    .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut state = 1_u32;
    for part in 0..count {
        let file = std::fs::File::create(folder.path().join(format!("run_{part}.mcap"))).unwrap();
        let mut writer = EpisodeWriter::create(file, &spec).unwrap();
        for step in 0..1400 {
            let mut noise = || {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                f32::from_bits(state & 0xbfff_ffff)
            };
            let proprioception: Vec<f32> = (0..SIZE).map(|_| noise()).collect();
            let stamp = (part * 1400 + step) * 100_000_000;
            writer.step(stamp, StepRef { frames: &[], proprioception: &proprioception, action: &[0.5] }).unwrap();
        }
        writer.finish().unwrap();
    }
    folder
}

fn joined(paths: &[PathBuf]) -> Vec<u8> {
    let mut bytes = Vec::new();
    join(paths, &mut bytes).unwrap();
    bytes
}

fn paths(folder: &tempfile::TempDir, count: usize) -> Vec<PathBuf> {
    (0..count).map(|part| folder.path().join(format!("run_{part}.mcap"))).collect()
}

#[tokio::test]
async fn parts_are_sent_as_one_recording_and_resume_where_they_broke() {
    let folder = parts(3);
    let expected = joined(&paths(&folder, 3));
    assert!(expected.len() > 3 * PIECE, "{}", expected.len());
    for faults in [&[][..], &[Fault::WriteBreaks, Fault::WriteBreaks]] {
        let fake = Fake::default();
        fake.store().faults.extend(faults);
        let (client, serving) = connected(&fake).await;
        let uploaded = client.upload("pick", folder.path(), &label(), |_| {}).await.unwrap();
        serving.abort();
        assert_eq!(fake.store().stored.as_ref().unwrap().1, expected);
        let name = folder.path().file_name().unwrap().to_string_lossy().into_owned();
        assert_eq!(uploaded.episode.file_name, format!("{name}.mcap"));
    }
}

#[tokio::test]
async fn named_parts_and_single_parts_are_sent_too() {
    let folder = parts(2);
    let fake = Fake::default();
    let (client, serving) = connected(&fake).await;
    let mut parts = paths(&folder, 2);
    parts.reverse();
    let item = PushItem { path: parts[0].clone(), parts: parts.clone(), task: "pick".into(), label: label() };
    let pushed = client.push(vec![item], 1, |_| {}).await;
    assert_eq!(pushed.results[0].result.as_ref().unwrap().episode.file_name, "run.mcap");
    assert_eq!(fake.store().stored.take().unwrap().1, joined(&paths(&folder, 2)));

    std::fs::remove_file(folder.path().join("run_1.mcap")).unwrap();
    client.upload("pick", folder.path(), &label(), |_| {}).await.unwrap();
    let (episode, bytes) = fake.store().stored.take().unwrap();
    assert_eq!((episode.file_name.as_str(), bytes), ("run_0.mcap", std::fs::read(&parts[1]).unwrap()));
    serving.abort();
}

#[tokio::test]
async fn a_missing_part_is_refused_before_the_server_is_called() {
    let folder = parts(3);
    std::fs::remove_file(folder.path().join("run_1.mcap")).unwrap();
    let fake = Fake::default();
    let (client, serving) = connected(&fake).await;
    let error = client.upload("pick", folder.path(), &label(), |_| {}).await.unwrap_err().to_string();
    assert!(error.contains("run_1.mcap: this part is missing"), "{error}");
    std::fs::write(folder.path().join("run_1.mcap"), std::fs::read(folder.path().join("run_0.mcap")).unwrap()).unwrap();
    let error = client.upload("pick", folder.path(), &label(), |_| {}).await.unwrap_err().to_string();
    assert!(error.contains("run_1.mcap: it overlaps with"), "{error}");
    serving.abort();
    assert!(fake.store().offsets.is_empty() && fake.store().open.is_none());
}
