//! Tests of the parent module.

use super::*;
use crate::read::read_episode;
use crate::testing::arm;
use crate::write::tests::{START, written, written_arm};

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
    extract(&path, &spec, &Kept::unscored(2, 4), &out).unwrap();
    let (whole, part) = (read_episode(&path, &spec).unwrap().episode, read_episode(&out, &spec).unwrap().episode);
    assert_eq!(part.stamps(), &whole.stamps()[2..6]);
    assert_eq!(part.proprioception(), whole.proprioception()[6..18]);
    assert_eq!(part.action(), whole.action()[4..12]);
    let step = whole.frames().as_ref().len() / 8;
    assert_eq!(part.frames().as_ref(), &whole.frames().as_ref()[2 * step..6 * step]);
}

/// Two steps from the third on, of which the first is kept and matched.
fn scored() -> Kept {
    let first = StepScore { q: 0.5, w: -2.0, kept: true, matched: Some(("ep_expert".into(), 7)) };
    let second = StepScore { q: 0.75, w: -1.5, kept: false, matched: None };
    let about = BTreeMap::from([("run".to_owned(), "run_1".to_owned())]);
    Kept { first_step: 3, scores: vec![first, second], about }
}

/// What our own reader finds on the topics of scores, one row a message: topic, log time, and the values of `fields`.
fn scores(path: &Path, fields: &[&str]) -> Vec<(String, u64, String)> {
    let mut channels = Channels::new(&Limits::default());
    let mut found = Vec::new();
    scan(path, &Limits::default(), &mut |record| {
        let Record::Message { header, data } = record else { return channels.declare(&record, &scores::is_own) };
        if let Some((topic, _, decoder)) = channels.next(header.channel_id)
            && let Ok(decoder) = &**decoder
        {
            let value = decoder.decode(data).unwrap();
            let shown = |name: &&str| match (value.number(name), value.text(name)) {
                (Some(number), _) => format!("{number}"),
                (None, text) => format!("{text:?}"),
            };
            found.push((topic.to_owned(), header.log_time, fields.iter().map(shown).collect::<Vec<_>>().join(" ")));
        }
        Ok(())
    })
    .unwrap();
    found
}

/// A recording of ROS 2 messages with 8 steps at 10 Hz, and the task that reads it.
fn ros_recording(path: &Path) -> TaskSpec {
    let mut writer = mcap_writer(File::create(path).unwrap(), "ros2").unwrap();
    for step in 0..8_u32 {
        let value = f64::from(step);
        for (topic, name, text, values) in [
            ("/joints", "lab/msg/Joints", "float64[2] position\n", vec![value, -value]),
            ("/tool", "lab/msg/Tool", "float64 x\n", vec![value]),
            ("/command", "lab/msg/Command", "float64[2] values\n", vec![value, 1.0]),
        ] {
            let schema = writer.add_schema(name, "ros2msg", text.as_bytes()).unwrap();
            let channel_id = writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap();
            let time = 1_000_000_000 + u64::from(step) * 100_000_000;
            let header = MessageHeader { channel_id, sequence: step, log_time: time, publish_time: time };
            let numbers = values.iter().flat_map(|value| value.to_le_bytes());
            let data: Vec<u8> = [0, 1, 0, 0].into_iter().chain(numbers).collect();
            writer.write_to_known_channel(&header, &data).unwrap();
        }
    }
    writer.finish().unwrap();
    let mut spec = arm();
    spec.cameras.clear();
    spec.mappings[0].cameras.clear();
    spec
}

#[test]
fn scores_beside_protobuf_are_one_message_of_plain_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    std::fs::write(&path, written(8)).unwrap();
    extract(&path, &written_arm(), &scored(), &out).unwrap();
    let row = |step: u64, values: &str| {
        ("/gleaner/quality".to_owned(), START.unsigned_abs() + step * 100_000_000, values.to_owned())
    };
    let fields = ["step", "q", "w", "kept", "match_episode", "match_step"];
    let expected = [row(3, "3 0.5 -2 1 Some(\"ep_expert\") 7"), row(4, "4 0.75 -1.5 0 Some(\"\") 0")];
    assert_eq!(scores(&out, &fields), expected);
    // Scores of the copy of a copy are those of its own, and its steps are the same.
    let again = folder.path().join("c.mcap");
    let kept = Kept { first_step: 0, scores: scored().scores.split_off(1), ..Kept::default() };
    extract(&out, &written_arm(), &kept, &again).unwrap();
    assert_eq!(scores(&again, &["step", "q"]), [("/gleaner/quality".to_owned(), row(3, "").1, "0 0.75".to_owned())]);
}

#[test]
fn scores_beside_ros_messages_are_ros_messages() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let spec = ros_recording(&path);
    extract(&path, &spec, &scored(), &out).unwrap();
    let row = |topic: &str, step: u64, value: &str| {
        (format!("/gleaner/{topic}"), 1_000_000_000 + step * 100_000_000, value.to_owned())
    };
    let expected = [
        row("q", 3, "0.5"),
        row("w", 3, "-2"),
        row("step", 3, "3"),
        row("kept", 3, "1"),
        row("match_episode", 3, "Some(\"ep_expert\")"),
        row("match_step", 3, "7"),
        row("q", 4, "0.75"),
        row("w", 4, "-1.5"),
        row("step", 4, "4"),
        row("kept", 4, "0"),
    ];
    assert_eq!(scores(&out, &["data"]), expected);
    let bytes = std::fs::read(&out).unwrap();
    let encodings: BTreeSet<String> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| message.unwrap().channel.message_encoding.clone())
        .collect();
    assert_eq!(encodings, BTreeSet::from(["cdr".to_owned()]));
    assert_eq!(read_episode(&out, &spec).unwrap().episode.action(), [3.0, 1.0, 4.0, 1.0]);
}

#[test]
fn the_copy_of_a_whole_episode_has_every_message() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    std::fs::write(&path, written(8)).unwrap();
    extract(&path, &written_arm(), &Kept::unscored(0, 8), &out).unwrap();
    let (scored, copies): (Vec<_>, Vec<_>) = messages(&out).into_iter().partition(|(topic, ..)| scores::is_own(topic));
    assert_eq!(copies, messages(&path));
    assert_eq!(scored.len(), 8);
}

#[test]
fn the_messages_are_the_originals_with_scores_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    std::fs::write(&path, written(8)).unwrap();
    extract(&path, &written_arm(), &scored(), &out).unwrap();
    let originals = messages(&path);
    let (scored, copies): (Vec<_>, Vec<_>) = messages(&out).into_iter().partition(|(topic, ..)| scores::is_own(topic));
    assert_eq!((scored.len(), copies.len()), (2, 8));
    assert!(copies.iter().all(|copy| originals.contains(copy)));
    let mut names = Vec::new();
    scan(&out, &Limits::default(), &mut |record| {
        if let Record::Metadata { name, values } = record {
            names.push((name.to_owned(), values.get("source").cloned(), values.get("run").cloned()));
        }
        Ok(())
    })
    .unwrap();
    let named = |name: &str, source: Option<&str>, run: Option<&str>| {
        (name.to_owned(), source.map(str::to_owned), run.map(str::to_owned))
    };
    assert_eq!(names, [named("session", None, None), named("gleaner", Some("a.mcap"), Some("run_1"))]);
}

#[test]
fn a_stretch_outside_the_episode_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, written(4)).unwrap();
    let problem = |first_step, steps| {
        let kept = Kept::unscored(first_step, steps);
        extract(&path, &written_arm(), &kept, &folder.path().join("b.mcap")).unwrap_err().to_string()
    };
    for (first_step, steps) in [(2, 3), (3, 0), (u64::MAX, 1), (4, 1)] {
        assert!(problem(first_step, steps).contains("the episode's 4 steps"), "{}", problem(first_step, steps));
    }
}
