//! Every stage once: recordings, encoder, scores, dataset, export, policy; pipelines; labels.

use gleaner_proto::v1::*;
use serde_json::json;

use crate::support::{api::Api, lab};

#[tokio::test]
async fn recordings_become_scores_datasets_and_a_policy() {
    let (_server, mut api, episodes) = lab::with_episodes(&[]).await;

    let encoder = api.succeed(lab::TASK, lab::pretrain(12)).await;
    let losses = api.metric(&encoder.id, "loss").await;
    assert_eq!(losses.len(), 12, "{losses:?}");
    assert!(losses.iter().all(|(_, loss)| loss.is_finite()));

    let run = api.succeed(lab::TASK, lab::score(&encoder.result_id)).await.result_id;
    expect_scores(&mut api, &run, &episodes).await;

    let dataset = create_dataset(&mut api, &run, 0.5).await;
    expect_segments(&mut api, &dataset, 0.5).await;
    expect_export(&mut api, &dataset).await;

    let policy = api.succeed(lab::TASK, lab::train(train_spec::Data::DatasetId(dataset.id.clone()), 6)).await.result_id;
    let base = api.succeed(lab::TASK, lab::train(train_spec::Data::ExpertsOf(encoder.result_id), 6)).await.result_id;
    let policies = api.policies().await;
    let ids: Vec<&str> = policies.iter().map(|policy| policy.id.as_str()).collect();
    assert_eq!(ids, [base.as_str(), policy.as_str()], "newest first");
    assert_eq!((policies[0].dataset_id.as_str(), policies[1].dataset_id.as_str()), ("", dataset.id.as_str()));
}

/// Every imperfect segment has w ≤ 0, q in [0, 1], the sum of distances is −w, and q spans the whole range.
async fn expect_scores(api: &mut Api, run: &str, episodes: &[Episode]) {
    let described = api
        .scores
        .get_score_run(GetScoreRunRequest { score_run_id: run.into() })
        .await
        .unwrap()
        .into_inner()
        .score_run
        .unwrap();
    let settings = lab::given(&described.settings);
    assert_eq!((&settings["similarity"], &settings["normaliser"]), (&json!("segment_l2"), &json!("calibrated")));
    let mut every_q = Vec::new();
    for episode in episodes {
        let scores = api.episode_scores(run, &episode.id).await;
        let steps = usize::try_from(episode.steps).unwrap();
        assert_eq!(scores.q.len(), steps);
        assert_eq!(scores.match_step.len(), steps);
        for step in 0..steps {
            let total = scores.distance_o[step] + scores.distance_m[step] + scores.distance_a[step];
            assert!((f64::from(total) + scores.w[step]).abs() < 1e-3, "step {step}: {total} and {}", scores.w[step]);
            let matched = &scores.expert_ids[usize::try_from(scores.match_episode[step]).unwrap()];
            assert_ne!(matched, &episode.id, "an episode matched itself");
        }
        if scores.role() == Role::Imperfect {
            every_q.extend(scores.q);
        }
    }
    let (low, high) = every_q.iter().fold((f32::MAX, f32::MIN), |(low, high), &q| (low.min(q), high.max(q)));
    assert!(0.0 <= low && low < high && high <= 1.0, "{low} to {high}");
    assert_eq!(u64::try_from(every_q.len()).unwrap(), described.imperfect_segments);
}

async fn create_dataset(api: &mut Api, run: &str, beta: f64) -> Dataset {
    let request = GetHistogramRequest { score_run_id: run.into(), bins: 10, betas: vec![0.0, beta, 1.0] };
    let histogram = api.scores.get_histogram(request).await.unwrap().into_inner();
    assert_eq!(histogram.counts.iter().sum::<u64>(), histogram.segments);
    assert!(histogram.kept[0].segments < histogram.segments, "q = 0 is not kept at β = 0");
    assert_eq!(histogram.kept[2].segments, 0, "nothing exceeds 1");

    let request = CreateDatasetRequest { score_run_id: run.into(), selection: Some(lab::above(beta)) };
    let dataset = api.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap();
    assert_eq!(dataset.kept_segments, Some(histogram.kept[1].segments));
    assert_eq!(dataset.kept_episodes, Some(histogram.kept[1].episodes));
    dataset
}

async fn expect_segments(api: &mut Api, dataset: &Dataset, beta: f64) {
    let request = StreamSegmentsRequest { dataset_id: dataset.id.clone(), include_frames: true, kept_only: false };
    let mut segments = api.datasets.stream_segments(request).await.unwrap().into_inner();
    let (mut experts, mut kept) = (0, 0);
    while let Some(message) = segments.message().await.unwrap() {
        let segment = message.segment.unwrap();
        let steps = usize::try_from(segment.end_step - segment.first_step + 1).unwrap();
        assert!((1..=4).contains(&steps), "l = 3");
        assert_eq!(segment.action.len(), steps * 7);
        // Two cameras, RGB and 16-bit depth.
        assert_eq!(segment.frames.len(), steps * 2 * 16 * 16 * 5);
        match segment.role() {
            Role::Expert => {
                experts += 1;
                assert_eq!(segment.weight, 1.0);
            }
            _ => {
                kept += 1;
                assert!(f64::from(segment.weight) > beta);
            }
        }
    }
    assert_eq!((Some(experts), Some(kept)), (dataset.expert_segments, dataset.kept_segments));
}

async fn expect_export(api: &mut Api, dataset: &Dataset) {
    let spec = job_spec::Spec::Export(ExportSpec {
        dataset_id: dataset.id.clone(),
        format: ExportFormat::Mcap.into(),
        ..ExportSpec::default()
    });
    let export = api.succeed(lab::TASK, spec).await.result_id;
    let request = ListExportFilesRequest { export_id: export.clone(), ..Default::default() };
    let files = api.datasets.list_export_files(request).await.unwrap().into_inner().files;
    assert!(files.iter().any(|file| file.name == "manifest.jsonl"), "{files:?}");
    let mut recordings = 0;
    for file in &files {
        let request =
            DownloadExportFileRequest { export_id: export.clone(), name: file.name.clone(), accept_url: false };
        let mut chunks = api.datasets.download_export_file(request).await.unwrap().into_inner();
        let mut bytes = Vec::new();
        while let Some(chunk) = chunks.message().await.unwrap() {
            bytes.extend_from_slice(&chunk.data);
        }
        assert_eq!(blake3::hash(&bytes).to_hex().to_string(), file.blake3);
        if file.name.ends_with(".mcap") {
            // An exported file is a recording of the same task.
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("stretch.mcap");
            std::fs::write(&path, &bytes).unwrap();
            match gleaner_recording::read_episode(&path, &lab::spec()) {
                Ok(reading) => assert!(reading.episode.steps() > 1),
                // A stretch of a single step is exported too.
                Err(gleaner_recording::RecordingError::Rejected(report)) => assert_eq!(report.steps, 1, "{report:?}"),
                Err(error) => panic!("{}: {error}", file.name),
            }
            recordings += 1;
        }
    }
    assert!(recordings >= 7, "six experts and at least one kept stretch: {files:?}");
}

#[tokio::test]
async fn pipeline_is_submitted_at_once_and_runs_in_order() {
    let (_server, mut api, _) = lab::with_episodes(&[]).await;
    let (job_spec::Spec::Pretrain(pretrain), job_spec::Spec::Train(train)) =
        (lab::pretrain(4), lab::train(train_spec::Data::DatasetId(String::new()), 4))
    else {
        unreachable!()
    };
    let pipeline = PipelineSpec {
        pretrain: Some(pretrain),
        score: true,
        beta: Some(0.5),
        top_fraction: None,
        shape: Some(SelectionShape { context_after: 1, ..SelectionShape::default() }),
        train: Some(TrainSpec { data: None, ..train }),
        scoring: Some(ScoreSpec {
            settings: lab::settings(json!({"similarity": "last_cosine"})),
            ..ScoreSpec::default()
        }),
        evaluate: Some(EvaluateSpec { subject: None, settings: lab::settings(json!({"episodes": 2, "max_steps": 3})) }),
    };
    let request = SubmitPipelineRequest { task: lab::TASK.into(), pipeline: Some(pipeline), ..Default::default() };
    let submitted = api.jobs.submit_pipeline(request).await.unwrap().into_inner();
    let kinds: Vec<JobKind> = submitted.jobs.iter().map(Job::kind).collect();
    assert_eq!(kinds, [JobKind::Pretrain, JobKind::Score, JobKind::Train, JobKind::Evaluate]);
    assert_eq!(submitted.jobs[1].needs, [submitted.jobs[0].id.clone()]);

    let last = api.watch(&submitted.jobs[3].id).await;
    assert_eq!(last.state(), JobState::Succeeded, "{}", last.error);
    let dataset = GetDatasetRequest { dataset_id: submitted.dataset_id };
    assert!(api.datasets.get_dataset(dataset).await.unwrap().into_inner().dataset.unwrap().kept_segments.is_some());
}

#[tokio::test]
async fn labels_keep_their_history_and_change_the_next_snapshot() {
    let (_server, mut api, episodes) = lab::with_episodes(&["--workers", "0"]).await;
    let relabel = LabelEpisodesRequest {
        episode_ids: vec![episodes[0].id.clone(), episodes[1].id.clone()],
        outcome: Outcome::Failure.into(),
        cohort: None,
        author: "ada".into(),
        reason: "the cube slipped".into(),
    };
    api.episodes.label_episodes(relabel).await.unwrap();
    let request = ListLabelsRequest { episode_id: episodes[0].id.clone(), ..Default::default() };
    let labels = api.episodes.list_labels(request).await.unwrap().into_inner().labels;
    let history: Vec<(Outcome, &str)> = labels.iter().map(|label| (label.outcome(), label.author.as_str())).collect();
    assert_eq!(history, [(Outcome::Success, "tests"), (Outcome::Failure, "ada")]);

    let request = CreateSnapshotRequest { task: lab::TASK.into(), rule: None };
    let snapshot = api.snapshots.create_snapshot(request).await.unwrap().into_inner().snapshot.unwrap();
    assert_eq!((snapshot.expert_episodes, snapshot.imperfect_episodes), (4, 8));
}
