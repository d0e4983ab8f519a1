//! Tests of the parent module.

use super::*;
use crate::read::read_episode;
use crate::write::tests::{written, written_arm};

fn messages(path: &Path) -> Vec<(String, u64, Vec<u8>)> {
    let bytes = std::fs::read(path).unwrap();
    let stream = mcap::MessageStream::new(&bytes).unwrap();
    stream
        .map(|message| {
            message.map(|message| (message.channel.topic.clone(), message.log_time, message.data.into_owned())).unwrap()
        })
        .collect()
}

#[test]
fn a_stretch_reads_as_the_same_steps() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    std::fs::write(&path, written(8)).unwrap();
    let spec = written_arm();
    let kept = Kept { first_step: 2, last_step: 5, quality: vec![0.9, 0.91, 0.92, 0.93], weight: vec![-1.0; 4] };
    extract(&path, &spec, &kept, &out).unwrap();
    let (whole, part) = (read_episode(&path, &spec).unwrap().episode, read_episode(&out, &spec).unwrap().episode);
    assert_eq!(part.stamps(), &whole.stamps()[2..6]);
    assert_eq!(part.proprioception(), whole.proprioception()[6..18]);
    assert_eq!(part.action(), whole.action()[4..12]);
    let step = whole.frames().as_ref().len() / 8;
    assert_eq!(part.frames().as_ref(), &whole.frames().as_ref()[2 * step..6 * step]);
}

#[test]
fn the_messages_are_the_originals_with_quality_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    std::fs::write(&path, written(8)).unwrap();
    let kept = Kept { first_step: 3, last_step: 4, quality: vec![0.5, 0.75], weight: vec![-2.0, -1.5] };
    extract(&path, &written_arm(), &kept, &out).unwrap();
    let originals = messages(&path);
    let (quality, copies): (Vec<_>, Vec<_>) =
        messages(&out).into_iter().partition(|(topic, ..)| topic == QUALITY_TOPIC);
    assert_eq!(copies.len(), 8);
    assert!(copies.iter().all(|copy| originals.contains(copy)));
    let values: Vec<serde_json::Value> =
        quality.iter().map(|(.., data)| serde_json::from_slice(data).unwrap()).collect();
    assert_eq!(
        values,
        [serde_json::json!({"step": 3, "q": 0.5, "w": -2.0}), serde_json::json!({"step": 4, "q": 0.75, "w": -1.5})]
    );
    let mut names = Vec::new();
    scan(&out, &Limits::default(), &mut |record| {
        if let Record::Metadata { name, values } = record {
            names.push((name.to_owned(), values.get("source").cloned()));
        }
        Ok(())
    })
    .unwrap();
    assert_eq!(names, [("session".to_owned(), None), ("gleaner".to_owned(), Some("a.mcap".to_owned()))]);
}

#[test]
fn a_stretch_outside_the_episode_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, written(4)).unwrap();
    let problem = |first_step, last_step, values| {
        let kept = Kept { first_step, last_step, quality: vec![1.0; values], weight: vec![1.0; values] };
        extract(&path, &written_arm(), &kept, &folder.path().join("b.mcap")).unwrap_err().to_string()
    };
    assert!(problem(2, 4, 3).contains("4 steps"));
    assert!(problem(3, 2, 0).contains("first ≤ last"));
    assert!(problem(1, 2, 1).contains("quality has 1 values"));
    assert!(problem(u64::MAX, u64::MAX, 1).contains("4 steps"));
}
