//! Selections: counts of kept segments, datasets, limits of snapshots, and score runs that extend others.

use std::{collections::BTreeMap, path::Path};

use gleaner_core::{
    id::EpisodeId,
    proto::selection::selection_to_proto,
    selection::{Candidate, ExpertRanking, Resolved, Selection as Choice, SelectionShape as Shape, places, ranked},
};
use gleaner_proto::v1::*;
use serde_json::{Value, json};

use crate::support::{
    api::Api,
    lab,
    shared::{Shared, shared},
};

mod cohorts;

/// One imperfect segment: episode, end step, w, q.
type Scored = (String, u32, f64, f32);

async fn imperfect(api: &mut Api, shared: &Shared) -> Vec<Scored> {
    let mut all = Vec::new();
    for episode in &shared.episodes {
        let scores = api.episode_scores(&shared.run, &episode.id).await;
        if scores.role() == Role::Imperfect {
            all.extend((0..).zip(scores.w).zip(scores.q).map(|((end, w), q)| (episode.id.clone(), end, w, q)));
        }
    }
    all
}

/// `CountKept` equals a count by hand and the segments of the dataset.
#[tokio::test]
async fn counts_equal_the_datasets() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let all = imperfect(&mut api, &shared).await;
    let mut ranked: Vec<(f32, f64)> = all.iter().map(|(_, _, w, q)| (*q, *w)).collect();
    ranked.sort_by(|a, b| b.partial_cmp(a).unwrap());
    let third = ranked[ranked.len().div_ceil(3) - 1];

    let selections = vec![lab::above(0.5), lab::top(1.0 / 3.0), lab::above(1.0), lab::top(1.0)];
    let request =
        CountKeptRequest { score_run_id: shared.run.clone(), selections: selections.clone(), per_episode: true };
    let counts = api.scores.count_kept(request).await.unwrap().into_inner().counts;
    let keeps: [&dyn Fn(&Scored) -> bool; 4] =
        [&|one| one.3 > 0.5, &|one| (one.3, one.2) >= third, &|_| false, &|_| true];
    for ((count, selection), keeps) in counts.iter().zip(&selections).zip(keeps) {
        assert_eq!(count.selection.as_ref(), Some(selection));
        let kept: Vec<&Scored> = all.iter().filter(|one| keeps(one)).collect();
        let mut by_episode: BTreeMap<&str, u64> = BTreeMap::new();
        kept.iter().for_each(|one| *by_episode.entry(&one.0).or_default() += 1);
        let total = count.total.unwrap();
        assert_eq!((total.segments, total.of_segments), (kept.len() as u64, all.len() as u64));
        assert_eq!((total.episodes, total.of_episodes), (by_episode.len() as u64, 6));
        assert_eq!(count.episodes.len(), 6);
        for of in &count.episodes {
            assert_eq!(of.segments, by_episode.get(of.episode_id.as_str()).copied().unwrap_or(0));
        }
        let cohorts: Vec<_> = count.cohorts.iter().map(|of| (of.cohort.as_str(), of.kept)).collect();
        assert_eq!(cohorts, [("failed", Some(total))]);
        let lowest = kept.iter().map(|one| one.2).min_by(f64::total_cmp);
        assert_eq!(count.threshold, lowest.unwrap_or(0.0));

        let request = CreateDatasetRequest { score_run_id: shared.run.clone(), selection: Some(*selection) };
        let dataset = api.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap();
        let request = CreateDatasetRequest { score_run_id: shared.run.clone(), selection: Some(*selection) };
        let again = api.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap();
        assert_eq!(again, dataset, "one selection of a run is one dataset");
        assert_eq!((dataset.kept_segments, dataset.kept_episodes), (Some(total.segments), Some(total.episodes)));
        assert_eq!(streamed(&mut api, &dataset.id).await, expected(&kept));
    }
}

fn expected(kept: &[&Scored]) -> Vec<(String, u32, f32)> {
    let mut segments: Vec<_> = kept.iter().map(|one| (one.0.clone(), one.1, one.3)).collect();
    segments.sort_by(|a, b| (&a.0, a.1).cmp(&(&b.0, b.1)));
    segments
}

async fn streamed(api: &mut Api, dataset: &str) -> Vec<(String, u32, f32)> {
    let request = StreamSegmentsRequest { dataset_id: dataset.into(), kept_only: true, include_frames: false };
    let mut stream = api.datasets.stream_segments(request).await.unwrap().into_inner();
    let mut segments = Vec::new();
    while let Some(message) = stream.message().await.unwrap() {
        let segment = message.segment.unwrap();
        segments.push((segment.episode_id, segment.end_step, segment.weight));
    }
    segments.sort_by(|a, b| (&a.0, a.1).cmp(&(&b.0, b.1)));
    segments
}

/// The imperfect episodes of the run, as selections read them.
async fn candidates(api: &mut Api, shared: &Shared) -> Vec<Candidate> {
    let steps: BTreeMap<&str, u64> = shared.episodes.iter().map(|one| (one.id.as_str(), one.steps)).collect();
    let mut candidates = Vec::new();
    for episode in &shared.episodes {
        let scores = api.episode_scores(&shared.run, &episode.id).await;
        if scores.role() == Role::Imperfect {
            let lengths: Vec<u64> = scores.expert_ids.iter().map(|id| steps[id.as_str()]).collect();
            candidates.push(Candidate {
                episode_id: EpisodeId::parse("id", &episode.id).unwrap(),
                cohort: "failed".into(),
                places: places(&scores.match_episode, &scores.match_step, &lengths).unwrap(),
                w: scores.w,
                q: scores.q,
            });
        }
    }
    candidates
}

/// Episode, end step and q of the segments that a selection keeps by its definition.
fn defined(selection: Choice, candidates: &[Candidate]) -> Vec<(String, u32, f32)> {
    let ranked = ranked(candidates);
    let (resolved, mut marked) = (Resolved::new(selection, &ranked, candidates, &ExpertRanking::default()), Vec::new());
    let mut kept = Vec::new();
    for one in candidates {
        resolved.mark(one, &mut marked);
        let steps = (0..).zip(&one.q).zip(&marked).filter(|(_, kept)| **kept);
        kept.extend(steps.map(|((step, q), _)| (one.episode_id.to_string(), step, *q)));
    }
    kept
}

/// Episode, step and q of the kept steps in the manifest of an export of the dataset.
async fn exported(api: &mut Api, dataset: &str) -> Vec<(String, u32, f64)> {
    let spec = ExportSpec { dataset_id: dataset.into(), format: ExportFormat::Mcap.into(), ..ExportSpec::default() };
    let export_id = api.succeed(lab::TASK, job_spec::Spec::Export(spec)).await.result_id;
    let request = DownloadExportFileRequest { export_id, name: "manifest.jsonl".into(), accept_url: false };
    let mut chunks = api.datasets.download_export_file(request).await.unwrap().into_inner();
    let mut bytes = Vec::new();
    while let Some(chunk) = chunks.message().await.unwrap() {
        bytes.extend_from_slice(&chunk.data);
    }
    let mut kept = Vec::new();
    for line in String::from_utf8(bytes).unwrap().lines() {
        let line: Value = serde_json::from_str(line).unwrap();
        for step in line["steps"].as_array().unwrap() {
            let end = u32::try_from(step["step"].as_u64().unwrap()).unwrap();
            kept.push((line["episode"].as_str().unwrap().to_owned(), end, step["q"].as_f64().unwrap()));
        }
    }
    kept
}

/// A dataset with every part of a shape counts, streams and exports the segments of the definition; one that keeps the
/// segments of another selection trains the same policy.
#[tokio::test]
async fn a_shaped_dataset_trains_and_exports_the_segments_of_its_definition() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let candidates = candidates(&mut api, &shared).await;
    let shape = Shape {
        min_expert_auroc: 0.0,
        close_gaps: 2,
        min_run: 3,
        context_before: 1,
        context_after: 2,
        max_share_of_episode: 0.6,
        phases: 4,
        max_per_phase: 9,
    };
    let selection = Choice { shape, ..Choice::beta(0.4) };
    let expected = defined(selection, &candidates);
    assert!(!expected.is_empty() && expected != defined(Choice::beta(0.4), &candidates), "{expected:?}");

    let dataset = api.dataset(&shared.run, selection).await;
    assert_eq!(dataset.selection, Some(selection_to_proto(selection)));
    assert_eq!(dataset.kept_segments, Some(expected.len() as u64));
    assert_eq!(streamed(&mut api, &dataset.id).await, expected);
    let mut steps = exported(&mut api, &dataset.id).await;
    steps.sort_by(|a, b| (&a.0, a.1).cmp(&(&b.0, b.1)));
    assert_eq!(steps.len(), expected.len());
    for ((episode, step, q), (of, end, weight)) in steps.iter().zip(&expected) {
        assert_eq!((episode, step), (of, end));
        assert!((q - f64::from(*weight)).abs() < 1e-6, "its own q: {q} and {weight}");
    }

    // The best N of one phase are the best N of the run.
    let all: usize = candidates.iter().map(|one| one.q.len()).sum();
    let most = all / 3;
    let limited = Shape { phases: 1, max_per_phase: u32::try_from(most).unwrap(), ..Shape::default() };
    let top = Choice::top_fraction(most as f64 / all as f64);
    let mut losses = Vec::new();
    for selection in [Choice { shape: limited, ..Choice::beta(0.0) }, top, selection] {
        let dataset = api.dataset(&shared.run, selection).await;
        let spec = lab::train(train_spec::Data::DatasetId(dataset.id), 4);
        let job = api.succeed(lab::TASK, spec).await;
        losses.push(api.metric(&job.id, "loss").await);
    }
    assert_eq!(losses[0], losses[1], "the same segments");
    assert_ne!(losses[0], losses[2], "other segments");
}

impl Api {
    async fn dataset(&mut self, run: &str, selection: Choice) -> Dataset {
        let selection = Some(selection_to_proto(selection));
        let request = CreateDatasetRequest { score_run_id: run.into(), selection };
        self.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap()
    }

    async fn snapshot(&mut self, rule: RoleRule) -> (String, Vec<SnapshotEpisode>) {
        let request = CreateSnapshotRequest { task: lab::TASK.into(), rule: Some(rule) };
        let snapshot = self.snapshots.create_snapshot(request).await.unwrap().into_inner().snapshot.unwrap();
        let request = GetSnapshotRequest { snapshot_id: snapshot.id.clone(), omit_episodes: false };
        (snapshot.id, self.snapshots.get_snapshot(request).await.unwrap().into_inner().episodes)
    }

    async fn run(&mut self, id: &str) -> ScoreRun {
        let request = GetScoreRunRequest { score_run_id: id.into() };
        self.scores.get_score_run(request).await.unwrap().into_inner().score_run.unwrap()
    }
}

fn limits(max_experts: u32, imperfect_per_expert: f64) -> RoleRule {
    RoleRule { max_experts, imperfect_per_expert, seed: 9, ..RoleRule::default() }
}

#[tokio::test]
async fn smaller_limits_of_snapshots_select_subsets() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let mut before: Vec<String> = Vec::new();
    for (max_experts, ratio, counts) in [(1, 1.0, (1, 1)), (2, 1.0, (2, 2)), (2, 3.0, (2, 6)), (0, 0.0, (6, 6))] {
        let (_, episodes) = api.snapshot(limits(max_experts, ratio)).await;
        let count = |role| episodes.iter().filter(|episode| episode.role() == role).count();
        assert_eq!((count(Role::Expert), count(Role::Imperfect)), counts);
        let now: Vec<String> = episodes.into_iter().map(|episode| episode.episode_id).collect();
        assert!(before.iter().all(|id| now.contains(id)), "a smaller limit gives a subset");
        before = now;
    }
}

/// Removes the kept features of score jobs, as a sweep may at any time; returns of how many episodes.
fn remove_features(data_dir: &Path) -> usize {
    let files = data_dir.join("cache").read_dir().unwrap().map(|entry| entry.unwrap().path());
    let features = files.filter(|path| path.extension().is_some_and(|extension| extension == "features"));
    features.map(|path| std::fs::remove_file(path).unwrap()).count()
}

/// A run that extends a smaller one has the scores of a full run, bit for bit, with the normaliser of the smaller one.
#[tokio::test]
async fn extended_run_equals_a_full_one() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let (small, _) = api.snapshot(limits(3, 1.0)).await;
    let score = |snapshot: &str, extends: &str| {
        job_spec::Spec::Score(ScoreSpec {
            encoder_id: if extends.is_empty() { shared.encoder.clone() } else { String::new() },
            snapshot_id: snapshot.into(),
            extends: extends.into(),
            settings: extends
                .is_empty()
                .then(|| json!({"scorer": "ssdf", "similarity": "segment_l2", "local_scale": false, "normaliser": "minmax"}))
                .and_then(lab::settings),
        })
    };
    remove_features(shared.server.data_dir());
    let base = api.succeed(lab::TASK, score(&small, "")).await.result_id;
    let grown = api.succeed(lab::TASK, score(&shared.snapshot, &base)).await.result_id;
    assert!(
        remove_features(shared.server.data_dir()) >= shared.episodes.len(),
        "the features of every episode are kept"
    );
    let full = api.succeed(lab::TASK, score(&shared.snapshot, "")).await.result_id;

    let (base, grown) = (api.run(&base).await, api.run(&grown).await);
    assert_eq!((grown.lo, grown.hi), (base.lo, base.hi), "the normaliser is frozen");
    let settings = lab::given(&grown.settings);
    assert_eq!((grown.extends.as_str(), &settings["similarity"]), (base.id.as_str(), &json!("segment_l2")));
    assert_eq!((&settings["feature_scale"], &settings["local_scale"]), (&json!("whitened"), &json!(false)));
    assert_eq!((grown.imperfect_episodes, base.imperfect_episodes), (6, 3));
    for episode in &shared.episodes {
        let incremental = api.episode_scores(&grown.id, &episode.id).await;
        let straight = api.episode_scores(&full, &episode.id).await;
        for (w, q) in incremental.w.iter().zip(&incremental.q) {
            let expected = ((w - base.lo) / (base.hi - base.lo)).clamp(0.0, 1.0);
            assert!((f64::from(*q) - expected).abs() < 1e-6);
        }
        assert_eq!(EpisodeScores { q: straight.q.clone(), ..incremental }, straight);
    }

    let refused = api.submit(lab::TASK, score(&small, &full)).await.unwrap_err();
    assert_eq!(refused.code(), tonic::Code::FailedPrecondition, "{refused}");
    assert!(refused.message().contains("expert"), "{refused}");
}
