//! Curation over a fresh database and real frame caches.

use gleaner_recording::{
    CameraSpec, Episode as Decoded, FieldSpec, PictureSizes, PixelFormat, TaskSpec, decode_color, frame_bytes_per_step,
};
use tempfile::TempDir;

use super::*;
use crate::{
    data_folder::frames_path,
    domain::{
        episode::{Episode, Outcome},
        score::Histogram,
        selection::{Candidate, Kept, Selection, SelectionShape},
        snapshot::Role,
        task::Task,
    },
    ingest::testing::open_on,
    store::testing::{self, results},
};

struct Lab {
    dir: TempDir,
    store: Store,
    curation: Curation,
    task: Task,
}

async fn lab(spec: &TaskSpec) -> Lab {
    let (dir, store) = testing::store().await;
    let task = store.insert_task(spec).await.unwrap();
    let curation = Curation::new(store.clone(), open_on(&dir, &store).await);
    Lab { dir, store, curation, task }
}

fn camera(name: &str, depth: bool) -> CameraSpec {
    CameraSpec { name: name.into(), height: 16, width: 16, depth, recorded: None }
}

/// Two cameras, two fields of proprioception.
fn seeing() -> TaskSpec {
    let field = |name: &str, size| FieldSpec::new(name, size);
    TaskSpec {
        cameras: vec![camera("front", true), camera("wrist", false)],
        proprioception: vec![field("joint_position", 2), field("gripper", 1)],
        ..testing::spec()
    }
}

/// A stored episode whose frame cache holds `steps` steps; every byte of a step's frame is ten times the step.
async fn recorded(lab: &Lab, steps: u8) -> Episode {
    let episode = testing::episode(&lab.store, &lab.task, Outcome::Failure, "").await;
    let spec = &lab.task.spec;
    let frames = (0..steps).flat_map(|step| vec![step * 10; frame_bytes_per_step(spec)]).collect();
    let proprioception = (0..steps).flat_map(|step| [0.0, 0.25, 0.5].map(|part| f32::from(step) + part)).collect();
    let action = (0..steps).map(|step| -f32::from(step)).collect();
    let stamps = (0..steps).map(|step| i64::from(step) * 100_000_000).collect();
    let decoded = Decoded::new(spec, stamps, proprioception, action, frames).unwrap();
    decoded.write_cache(spec, &frames_path(lab.dir.path(), &episode.recording, spec)).unwrap();
    episode
}

fn view(step: u64, camera: &str) -> FrameView {
    FrameView { step, camera: camera.into(), depth: false, size: None }
}

#[tokio::test]
async fn a_frame_is_the_recorded_step() {
    let lab = lab(&seeing()).await;
    let episode = recorded(&lab, 20).await;
    for (step, name) in [(0, "front"), (7, "wrist"), (19, "front")] {
        let jpeg = lab.curation.frame(&episode.id, view(step, name)).await.unwrap();
        let pixels = decode_color(&jpeg, PixelFormat::Jpeg, &PictureSizes::new(16, 16)).unwrap();
        let expected = u8::try_from(step * 10).unwrap();
        assert!(pixels.iter().all(|pixel| pixel.abs_diff(expected) <= 2), "step {step} of {name}");
    }
    let small = FrameView { size: Some(8), depth: true, ..view(3, "front") };
    let jpeg = lab.curation.frame(&episode.id, small).await.unwrap();
    assert!(decode_color(&jpeg, PixelFormat::Jpeg, &PictureSizes::new(8, 8)).is_ok());
}

#[tokio::test]
async fn a_missing_step_or_camera_is_named() {
    let lab = lab(&seeing()).await;
    let episode = recorded(&lab, 20).await;
    for (view, start) in [
        (view(20, "front"), "no step 20 of"),
        (view(u64::MAX, "front"), "no step 18446744073709551615 of"),
        (view(0, "side"), "no camera \"side\""),
    ] {
        let error = lab.curation.frame(&episode.id, view).await.unwrap_err();
        assert!(error.kind() == Kind::NotFound && error.message().starts_with(start), "{error}");
    }
    let unknown = lab.curation.frame(&EpisodeId::new(), view(0, "front")).await.unwrap_err();
    assert_eq!(unknown.kind(), Kind::NotFound);
}

#[tokio::test]
async fn a_deleted_episode_is_not_shown_though_it_was_read() {
    let lab = lab(&seeing()).await;
    let episode = recorded(&lab, 20).await;
    lab.curation.frame(&episode.id, view(0, "front")).await.unwrap();
    lab.store.delete_episodes(std::slice::from_ref(&episode.id), false).await.unwrap();
    lab.curation.frame(&episode.id, view(0, "front")).await.unwrap();
    lab.store.sweep_trash(crate::domain::time::Millis(i64::MAX)).await.unwrap();
    let gone = lab.curation.frame(&episode.id, view(0, "front")).await.unwrap_err();
    assert_eq!(gone.kind(), Kind::NotFound);
    assert_eq!(lab.curation.numbers(&episode.id).await.unwrap_err().kind(), Kind::NotFound);
    assert!(lab.curation.0.open.is_empty(), "its recording is no longer held");
}

#[tokio::test]
async fn numbers_are_returned_by_field() {
    let lab = lab(&seeing()).await;
    let episode = recorded(&lab, 3).await;
    let numbers = lab.curation.numbers(&episode.id).await.unwrap();
    assert_eq!(numbers.stamps_ns, [0, 100_000_000, 200_000_000]);
    let fields: Vec<_> = numbers.proprioception.iter().map(|one| (one.name.as_str(), one.size)).collect();
    assert_eq!(fields, [("joint_position", 2), ("gripper", 1)]);
    assert_eq!(numbers.proprioception[0].values, [0.0, 0.25, 1.0, 1.25, 2.0, 2.25]);
    assert_eq!(numbers.proprioception[1].values, [0.5, 1.5, 2.5]);
    assert_eq!(numbers.action[0].values, [-0.0, -1.0, -2.0]);
}

/// A run with these q of imperfect episodes, in two cohorts by turns.
async fn run_with(lab: &Lab, q: &[&[f32]]) -> (ScoreRunId, Vec<EpisodeId>) {
    let expert = testing::episode(&lab.store, &lab.task, Outcome::Success, "").await;
    let mut scores = Vec::new();
    for (place, q) in q.iter().enumerate() {
        let episode = testing::episode(&lab.store, &lab.task, Outcome::Failure, &format!("c{}", place % 2)).await;
        scores.push(results::scores(&episode.id, Role::Imperfect, q));
    }
    if q.is_empty() {
        testing::episode(&lab.store, &lab.task, Outcome::Failure, "").await;
    }
    let encoder = results::encoder(&lab.store, &lab.task).await;
    let imperfect = scores.iter().map(|scores| scores.episode_id.clone()).collect();
    scores.push(results::scores(&expert.id, Role::Expert, &[0.7, 0.95]));
    let run = results::run(&lab.store, &lab.task, &encoder, &scores).await;
    (run.id, imperfect)
}

#[tokio::test]
async fn a_summary_counts_by_cohort_and_episode() {
    let lab = lab(&testing::spec()).await;
    let (run, episodes) = run_with(&lab, &[&[0.1, 0.9, 0.9], &[0.5, 1.0], &[0.9]]).await;
    let summary = lab.curation.summary(&run).await.unwrap();
    assert_eq!(summary.run().id, run);
    let kept = |segments, of_segments, episodes, of_episodes| Kept { segments, of_segments, episodes, of_episodes };
    let shape = SelectionShape { context_before: 1, ..SelectionShape::default() };
    for (selection, total, first_cohort, each) in [
        (Selection::beta(0.9), kept(1, 6, 1, 3), kept(0, 4, 0, 2), [0, 1, 0]),
        (Selection::beta(0.4), kept(5, 6, 3, 3), kept(3, 4, 2, 2), [2, 2, 1]),
        (Selection::top_fraction(0.1), kept(1, 6, 1, 3), kept(0, 4, 0, 2), [0, 1, 0]),
        (Selection { shape, ..Selection::beta(0.9) }, kept(2, 6, 1, 3), kept(0, 4, 0, 2), [0, 2, 0]),
    ] {
        let counted = summary.what_if(selection).await.unwrap();
        assert_eq!((counted.total, counted.cohorts["c0"]), (total, first_cohort), "{selection:?}");
        let of: Vec<_> = counted.episodes.into_iter().map(|(id, kept, _)| (id, kept)).collect();
        assert_eq!(of, episodes.iter().cloned().zip(each).collect::<Vec<_>>(), "{selection:?}");
    }
    assert_eq!((summary.mean_q(&episodes[1]), summary.mean_q(&EpisodeId::new())), (Some(0.75), None));
    let (best, worst) = (summary.best(1).await.unwrap(), summary.worst(1).await.unwrap());
    assert_eq!((&best[0].episode_id, best[0].end_step, best[0].q), (&episodes[1], 1, 1.0));
    assert_eq!((&worst[0].episode_id, worst[0].end_step, worst[0].q), (&episodes[0], 0, 0.1));
    assert!(Arc::ptr_eq(&summary, &lab.curation.summary(&run).await.unwrap()), "read once");
    assert_eq!(lab.curation.count_kept(&ScoreRunId::new(), vec![]).await.unwrap_err().kind(), Kind::NotFound);
}

#[tokio::test]
async fn a_histogram_counts_imperfect_segments_and_experts_apart() {
    let lab = lab(&testing::spec()).await;
    let (run, _) = run_with(&lab, &[&[0.1, 0.9, 0.95], &[0.5, 0.9]]).await;
    let summary = lab.curation.summary(&run).await.unwrap();
    let histogram = summary.fill(Histogram::new(2, &[0.9, 0.5])).await.unwrap();
    assert_eq!((histogram.counts(), histogram.expert_counts()), (&[1, 4][..], &[0, 2][..]));
    let kept: Vec<_> = histogram.kept().iter().map(|kept| (kept.segments, kept.episodes)).collect();
    assert_eq!(kept, [(1, 1), (3, 2)], "q equal to β is not kept");
    assert_eq!(
        summary.expert_ranking().await.unwrap().all,
        Some(0.65),
        "0.7 beats two of five, 0.95 four, and a tie is half"
    );
    for bins in [2, 7, 20, 2] {
        let expected = summary.fill(Histogram::new(bins, &[])).await.unwrap();
        assert_eq!(summary.histogram(bins).await.unwrap(), expected, "{bins}");
    }
}

#[tokio::test]
async fn a_dataset_is_counted_once_its_run_is_finished_and_the_counts_are_stored() {
    let lab = lab(&testing::spec()).await;
    let (run, _) = run_with(&lab, &[&[0.6, 0.3], &[0.9]]).await;
    let of = lab.store.score_run(&run).await.unwrap();
    let encoder = lab.store.encoder(of.origin.encoder_id().unwrap()).await.unwrap();
    let (_, unfinished) = results::scoring(&lab.store, &lab.task, &encoder).await;
    let mut datasets = Vec::new();
    for (run, beta) in [(&run, 0.5), (&unfinished, 0.5), (&run, 0.0)] {
        datasets.push(lab.store.insert_dataset(run, Selection::beta(beta)).await.unwrap());
    }
    let some = |kept_segments, kept_episodes| Some(DatasetCounts { kept_segments, kept_episodes, expert_segments: 20 });
    let expected = [some(2, 2), None, some(3, 2)];
    assert_eq!(lab.curation.dataset_counts(&datasets).await.unwrap(), expected);
    assert_eq!(lab.store.dataset_counts(&datasets[2].id).await.unwrap(), expected[2]);
    lab.curation.0.runs.clear();
    assert_eq!(lab.curation.dataset_counts(&datasets).await.unwrap(), expected);
    assert!(lab.curation.0.runs.is_empty(), "no score is read again");
}

#[tokio::test]
async fn empty_runs_are_summarised_and_missing_ones_rejected() {
    let lab = lab(&testing::spec()).await;
    let (run, _) = run_with(&lab, &[]).await;
    let summary = lab.curation.summary(&run).await.unwrap();
    for selection in [Selection::beta(0.5), Selection::top_fraction(0.5)] {
        let counted = summary.what_if(selection).await.unwrap();
        assert_eq!((counted.total.of_segments, counted.threshold), (0, None));
    }
    assert!(summary.best(9).await.unwrap().is_empty() && summary.worst(9).await.unwrap().is_empty());
    assert_eq!(summary.histogram(4).await.unwrap().counts(), [0; 4]);
    let unknown = lab.curation.summary(&ScoreRunId::new()).await.map(|_| ()).unwrap_err();
    assert_eq!(unknown.kind(), Kind::NotFound);
}

#[tokio::test]
async fn concurrent_callers_share_one_read() {
    let lab = lab(&testing::spec()).await;
    let (run, _) = run_with(&lab, &[&[0.5]]).await;
    let summaries = futures::future::try_join_all((0..8).map(|_| lab.curation.summary(&run))).await.unwrap();
    assert!(summaries.iter().all(|one| Arc::ptr_eq(one, &summaries[0])));
}

#[tokio::test]
async fn few_runs_are_read_at_once() {
    let lab = lab(&testing::spec()).await;
    let (run, _) = run_with(&lab, &[&[0.5]]).await;
    let places = lab.curation.0.reads.acquire_many(u32::try_from(READS).unwrap()).await.unwrap();
    let mut reading = Box::pin(lab.curation.summary(&run));
    assert!(futures::poll!(&mut reading).is_pending());
    assert_eq!(lab.store.score_run(&run).await.unwrap().id, run, "the database answers others");
    assert!(futures::poll!(&mut reading).is_pending(), "it waits for a place");
    drop(places);
    let summary = reading.await.unwrap();
    let held = lab.curation.0.reads.acquire_many(u32::try_from(READS).unwrap()).await.unwrap();
    assert!(Arc::ptr_eq(&summary, &lab.curation.summary(&run).await.unwrap()), "a run in memory needs no place");
    drop(held);
}

/// A summary of this many segments, of one episode.
async fn sized(lab: &Lab, run: &ScoreRunId, segments: usize) -> Arc<Summary> {
    let run = lab.store.score_run(run).await.unwrap();
    let candidate = Candidate {
        episode_id: EpisodeId::new(),
        cohort: String::new(),
        w: Vec::new(),
        q: vec![0.0; segments],
        places: Vec::new(),
    };
    Arc::new(Summary::new(run, vec![candidate], Vec::new()))
}

#[tokio::test]
async fn memory_for_runs_is_bounded_and_a_huge_run_is_kept_alone() {
    let lab = lab(&testing::spec()).await;
    let (run, _) = run_with(&lab, &[&[0.5]]).await;
    let runs = &lab.curation.0.runs;
    for _ in 0..12 {
        runs.insert(ScoreRunId::new(), sized(&lab, &run, 1 << 20).await);
        assert!(runs.weight() <= RUN_BYTES);
    }
    assert!(runs.len() > 4, "several fit: {}", runs.len());
    let huge = ScoreRunId::new();
    runs.insert(huge.clone(), sized(&lab, &run, 12 << 20).await);
    assert!(runs.get(&huge).is_some() && runs.weight() <= RUN_BYTES);
}
