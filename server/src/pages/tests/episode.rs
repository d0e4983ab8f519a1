//! The page of one episode, complete or with missing data.

use gleaner_recording::{CameraSpec, Episode as Decoded, TaskSpec, frame_bytes_per_step};
use http::{
    StatusCode,
    header::{CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_TYPE},
};
use serde_json::{Value, json};

use crate::{
    data_folder::frames_path,
    domain::{
        episode::{Episode, Outcome},
        job::JobState,
        snapshot::Role,
        task::Task,
        time::Millis,
    },
    pages::testing::{Client, Pages, Reply},
    store::testing::{self, results},
};

struct Lab {
    pages: Pages,
    task: Task,
}

/// Pages over a task with one camera.
async fn lab() -> Lab {
    let pages = Pages::open(false).await;
    let camera = CameraSpec { name: "front".into(), height: 16, width: 16, depth: true, recorded: None };
    let spec = TaskSpec { cameras: vec![camera], ..testing::spec() };
    let task = pages.services.store.insert_task(&spec).await.unwrap();
    Lab { pages, task }
}

impl Lab {
    /// An episode of 20 steps, ten a second, whose frames are in the cache.
    async fn recorded(&self, outcome: Outcome) -> Episode {
        let episode = testing::episode(&self.pages.services.store, &self.task, outcome, "").await;
        let spec = &self.task.spec;
        let frames = (0..20_u8).flat_map(|step| vec![step * 10; frame_bytes_per_step(spec)]).collect();
        let numbers = |size: usize| (0..20 * size).map(|n| f32::from(u16::try_from(n).unwrap())).collect();
        let stamps = (0..20).map(|step| 5_000_000_000 + step * 100_000_000).collect();
        let (proprioception, action) = (numbers(spec.proprioception_size()), numbers(spec.action_size()));
        let decoded = Decoded::new(spec, stamps, proprioception, action, frames).unwrap();
        let place = frames_path(&self.pages.services.config.data_dir, &episode.recording, spec);
        decoded.write_cache(spec, &place).unwrap();
        episode
    }

    async fn get(&self, path: &str) -> Reply {
        self.pages.get(&Client::default(), path).await
    }
}

#[tokio::test]
async fn a_scored_episode_shows_its_kept_segments_and_matches() {
    let lab = lab().await;
    let (expert, weak) = (lab.recorded(Outcome::Success).await, lab.recorded(Outcome::Failure).await);
    let encoder = results::encoder(&lab.pages.services.store, &lab.task).await;
    let q: Vec<f32> = (0..20).map(|step: u8| f32::from(step) / 20.0).collect();
    let scores =
        [results::scores(&expert.id, Role::Expert, &[1.0; 20]), results::scores(&weak.id, Role::Imperfect, &q)];
    let run = results::run(&lab.pages.services.store, &lab.task, &encoder, &scores).await;

    let page = lab.get(&format!("/episodes/{}?step=7&beta=0.8", weak.id)).await;
    assert_eq!(page.status, StatusCode::OK, "{}", page.text());
    let text = page.text();
    assert!(text.contains("3 of 20 segments kept (15.0 %)"), "0.85, 0.9 and 0.95 are above 0.8");
    assert!(text.contains(&format!("/episodes/{}?step=7&amp;run={}", expert.id, run.id)), "the expert's step");
    assert!(text.contains(&format!("/episodes/{}/frames/front/7?depth=true", weak.id)));
    assert!(text.contains("1.9]"), "steps are shown in seconds from the first");

    let whole = lab.get(&format!("/episodes/{}?beta=1", expert.id)).await.text();
    assert!(whole.contains("kept in full for every β") && !whole.contains("segments kept ("), "{whole}");

    let content = lab.get(&format!("/episodes/{}/scores.json", weak.id)).await;
    let content: Value = serde_json::from_slice(&content.body).unwrap();
    assert_eq!((&content["run"], content["q"].as_array().unwrap().len()), (&json!(run.id), 20));
    assert_eq!((&content["experts"][0], &content["match_step"][7]), (&json!(expert.id), &json!(7)));
}

#[tokio::test]
async fn a_frame_is_an_image_that_browsers_cache() {
    let lab = lab().await;
    let episode = lab.recorded(Outcome::Success).await;
    let reply = lab.get(&format!("/episodes/{}/frames/front/3?size=8", episode.id)).await;
    assert_eq!((reply.status, &reply.headers[CONTENT_TYPE]), (StatusCode::OK, &"image/jpeg".parse().unwrap()));
    assert!(reply.headers[CACHE_CONTROL].to_str().unwrap().contains("immutable"));
    assert!(reply.body.starts_with(&[0xFF, 0xD8]));
    for (path, status) in [
        ("front/20", StatusCode::NOT_FOUND),
        ("rear/3", StatusCode::NOT_FOUND),
        ("front/-1", StatusCode::BAD_REQUEST),
        ("front/3?size=0", StatusCode::BAD_REQUEST),
        ("front/3?size=many", StatusCode::BAD_REQUEST),
    ] {
        let reply = lab.get(&format!("/episodes/{}/frames/{path}", episode.id)).await;
        assert_eq!(reply.status, status, "{path}");
        assert!(!reply.headers[CACHE_CONTROL].to_str().unwrap().contains("immutable"), "{path}");
    }
}

#[tokio::test]
async fn missing_data_is_reported_and_the_rest_is_shown() {
    let lab = lab().await;
    // Without frames, without a recording to decode them from, and without scores.
    let bare = testing::episode(&lab.pages.services.store, &lab.task, Outcome::Unknown, "").await;
    let text = lab.get(&format!("/episodes/{}", bare.id)).await.text();
    assert!(text.contains("No finished score run has scored this episode"));
    let found = format!("The steps of the recording cannot be shown: the blob {} is missing", bare.recording);
    assert!(text.contains(&found) && text.contains("--data-dir"), "{text}");
    assert!(text.contains("reach.mcap") && text.contains("data-label=\"success\""));

    lab.pages.services.store.delete_episodes(std::slice::from_ref(&bare.id), false).await.unwrap();
    let page = lab.get(&format!("/episodes/{}", bare.id)).await;
    assert!(page.status == StatusCode::OK && page.text().contains("In the trash since"));
    assert!(!page.text().contains("data-label="), "it cannot be labelled");
}

#[tokio::test]
async fn a_permanently_deleted_expert_is_no_link() {
    let lab = lab().await;
    let store = &lab.pages.services.store;
    let (expert, weak) = (lab.recorded(Outcome::Success).await, lab.recorded(Outcome::Failure).await);
    let encoder = results::encoder(store, &lab.task).await;
    let scores =
        [results::scores(&expert.id, Role::Expert, &[1.0; 20]), results::scores(&weak.id, Role::Imperfect, &[0.5; 20])];
    let run = results::run(store, &lab.task, &encoder, &scores).await;
    for job in [&encoder.job_id, run.origin.job_id().unwrap()] {
        results::set_state(store, job, JobState::Succeeded, "").await;
    }
    let page = format!("/episodes/{}?run={}", weak.id, run.id);
    let link = format!("/episodes/{}?step=", expert.id);
    assert!(lab.get(&page).await.text().contains(&link));
    store.delete_episodes(std::slice::from_ref(&expert.id), true).await.unwrap();
    let text = lab.get(&page).await.text();
    assert!(text.contains(&link) && text.contains("\"deleted\":[]"), "one in the trash has a page: {text}");
    assert_eq!(store.sweep_trash(Millis(i64::MAX)).await.unwrap().purged, 1);
    let text = lab.get(&page).await.text();
    assert!(!text.contains(&link) && text.contains(&format!("\"deleted\":[\"{}\"]", expert.id)), "{text}");
    assert!(!text.contains(&format!("/episodes/{}/frames/", expert.id)), "{text}");
}

#[tokio::test]
async fn the_page_links_to_its_snapshots() {
    let lab = lab().await;
    let store = &lab.pages.services.store;
    let expert = testing::episode(store, &lab.task, Outcome::Success, "").await;
    let weak = testing::episode(store, &lab.task, Outcome::Failure, "bob").await;
    assert!(!lab.get(&format!("/episodes/{}", weak.id)).await.text().contains("Used in snapshots"));
    let oldest = results::encoder(store, &lab.task).await.snapshot_id;
    testing::run(store, &format!("update episodes set outcome = 'success' where id = '{}'", weak.id)).await;
    let content = lab.get(&format!("/episodes/{}", weak.id)).await.text();
    let panel = content.split("Used in snapshots").nth(1).unwrap().split("</section>").next().unwrap();
    assert!(panel.contains(&format!("href=\"/snapshots/{oldest}\"")) && panel.contains(" as imperfect"), "{panel}");
    assert!(panel.contains("tag failure") && panel.contains("bob"), "as labelled then: {panel}");
    testing::episode(store, &lab.task, Outcome::Failure, "").await;
    for _ in 0..10 {
        results::encoder(store, &lab.task).await;
    }
    let content = lab.get(&format!("/episodes/{}", expert.id)).await.text();
    assert_eq!(content.matches("href=\"/snapshots/").count(), 8);
    assert!(content.contains("and 3 older snapshots") && !content.contains(oldest.as_str()), "{content}");
}

#[tokio::test]
async fn an_invalid_address_is_refused_by_name() {
    let lab = lab().await;
    let episode = lab.recorded(Outcome::Success).await;
    let other = "run_01ARZ3NDEKTSV4RRFFQ69G5FAV";
    for (path, status, content) in [
        ("/episodes/7".to_owned(), StatusCode::BAD_REQUEST, "episode: "),
        ("/episodes/ep_01ARZ3NDEKTSV4RRFFQ69G5FAV".to_owned(), StatusCode::NOT_FOUND, "no episode "),
        (format!("/episodes/{}?beta=high", episode.id), StatusCode::BAD_REQUEST, "beta: "),
        (format!("/episodes/{}?step=20", episode.id), StatusCode::NOT_FOUND, "no step 20"),
        (format!("/episodes/{}?run=x", episode.id), StatusCode::BAD_REQUEST, "run: "),
        (format!("/episodes/{}/scores.json", episode.id), StatusCode::NOT_FOUND, "no score run of"),
        (format!("/episodes/{}/scored.mcap", episode.id), StatusCode::NOT_FOUND, "no score run of"),
        (format!("/episodes/{}/scored.mcap?beta=2", episode.id), StatusCode::BAD_REQUEST, "beta: "),
        (format!("/episodes/{}/scored.mcap?run={other}", episode.id), StatusCode::NOT_FOUND, other),
    ] {
        let reply = lab.get(&path).await;
        assert_eq!(reply.status, status, "{path}");
        assert!(reply.text().contains(content), "{path} {}", reply.text());
    }
}

#[tokio::test]
async fn the_recording_and_the_labels_can_be_downloaded() {
    let lab = lab().await;
    let content = b"an mcap";
    let episode = testing::episode(&lab.pages.services.store, &lab.task, Outcome::Success, "weak").await;
    let blob = lab.pages.services.blobs.put(content).unwrap();
    let rename = format!("update episodes set recording = '{blob}', size_bytes = 7 where id = '{}'", episode.id);
    testing::run(&lab.pages.services.store, &rename).await;
    let turns = lab.pages.take_turns().await;
    let reply = lab.get(&format!("/episodes/{}/recording.mcap", episode.id)).await;
    assert_eq!((reply.status, reply.body.as_slice()), (StatusCode::OK, content.as_slice()), "it takes no turn");
    drop(turns);
    assert!(reply.headers[CONTENT_DISPOSITION].to_str().unwrap().contains(&format!("{}.mcap", episode.id)));
    let labels = lab.get(&format!("/episodes/{}?format=csv", episode.id)).await.text();
    assert!(
        labels.starts_with("labelled_at,outcome,cohort,labelled_by,reason\n")
            && labels.contains(",success,weak,tests,")
    );
}
