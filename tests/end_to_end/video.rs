//! Recordings of video, pushed with the `gleaner` command to a real server, whose inspector decodes them within its limits.

use std::path::Path;

use gleaner_data_folder::CACHE;
use gleaner_proto::v1::*;
use gleaner_recording::{CameraMessage, EpisodeWriter, FrameCache, TaskSpec, read_episode, written_mapping};
use serde_json::json;

use crate::support::{
    api::Api,
    command::{self, gleaner},
    files::{files, root},
    lab,
    server::TestServer,
};

/// Steps of each recording: as many as the streams have pictures.
const STEPS: usize = 12;

/// A task of three cameras, one for each codec, that learns from a crop of their pictures.
fn spec() -> TaskSpec {
    let camera = |name: &str| {
        json!({
            "name": name, "height": 12, "width": 16, "depth": false,
            "recorded": {"height": 48, "width": 64, "crop": {"top": 8, "left": 16, "height": 24, "width": 32}},
        })
    };
    let mut spec: TaskSpec = serde_json::from_value(json!({
        "name": lab::TASK, "rate_hz": 10.0, "mappings": [],
        "cameras": (["front", "left", "right"].map(camera)),
        "proprioception": [{"name": "joints", "size": 2}],
        "action": [{"name": "command", "size": 1}],
    }))
    .unwrap();
    spec.mappings = vec![written_mapping(&spec)];
    spec
}

/// The format of a stream of `gleaner-video`'s fixtures, and its packets.
fn stream(name: &str) -> (String, Vec<Vec<u8>>) {
    let file = |extension: &str| root().join("crates/video/fixtures").join(format!("{name}.{extension}"));
    let described: serde_json::Value = serde_json::from_slice(&std::fs::read(file("json")).unwrap()).unwrap();
    let bytes = std::fs::read(file("packets")).unwrap();
    let (mut rest, mut packets) = (bytes.as_slice(), Vec::new());
    while let Some((length, after)) = rest.split_first_chunk() {
        let (data, after) = after.split_at(u32::from_le_bytes(*length) as usize);
        packets.push(data.to_vec());
        rest = after;
    }
    (described["format"].as_str().unwrap().to_owned(), packets)
}

/// Writes a recording in which each camera shows one of these streams.
fn write(path: &Path, streams: &[(String, Vec<Vec<u8>>); 3]) {
    let mut writer = EpisodeWriter::create(std::fs::File::create(path).unwrap(), &spec()).unwrap();
    for step in 0..STEPS {
        let (stamp, value) = (i64::try_from(step).unwrap() * 100_000_000, step as f32);
        for (camera, (format, packets)) in streams.iter().enumerate() {
            writer.camera_message(camera, stamp, CameraMessage::Video { format, data: &packets[step] }).unwrap();
        }
        writer.sense(stamp, &[value, -value]).unwrap();
        writer.act(stamp, &[value]).unwrap();
    }
    writer.finish().unwrap();
}

#[tokio::test]
async fn a_recording_of_video_is_pushed_and_its_steps_are_the_decoded_pictures() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    let created = CreateTaskRequest { spec: Some(gleaner_core::proto::task::spec_to_proto(spec())) };
    api.tasks.create_task(created).await.unwrap();
    let (folder, mut streams) =
        (tempfile::tempdir().unwrap(), ["h264_baseline", "h265_low_delay", "av1_aom"].map(stream));
    let path = folder.path().join("film.mcap");
    let push = ["push", path.to_str().unwrap()];

    write(&path, &streams);
    command::json(server.url(), &push).await;
    let episodes = api.episodes().await;
    let [episode] = &episodes[..] else { panic!("{episodes:?}") };
    assert_eq!((episode.steps, episode.warnings), (12, 0));
    let mut caches = files(&server.data_dir().join(CACHE));
    caches.retain(|path| path.extension().is_some_and(|extension| extension == "frames"));
    let [cache] = &caches[..] else { panic!("{caches:?}") };
    let kept = FrameCache::open(cache, &spec()).unwrap().frames(0..STEPS).unwrap();
    assert!(kept == read_episode(&path, &spec()).unwrap().episode.frames().as_ref());

    // From the second key frame on, the first camera has another size.
    streams[0].1.truncate(6);
    streams[0].1.extend(stream("h264_cropped").1.into_iter().take(6));
    write(&path, &streams);
    let refused = gleaner(server.url(), &push).await;
    let text = refused.text();
    assert!(!refused.success && ["50×66", "48×64"].iter().all(|size| text.contains(size)), "{text}");
    assert_eq!(api.episodes().await.len(), 1);
}
