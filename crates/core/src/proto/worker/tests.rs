//! The messages to and from a worker survive the wire.

use prost::Message as _;

use super::*;
use crate::{
    dataset::{KeptSegment, Nearest},
    id::{DatasetId, TaskId},
    job::{JobSpec, JobState},
    snapshot::Role,
    time::Millis,
    work::KeptInput,
};

fn blob(text: &str) -> BlobId {
    blake3::hash(text.as_bytes()).into()
}

fn input(text: &str) -> InputEpisode {
    InputEpisode {
        id: EpisodeId::new(),
        recording: blob(text),
        steps: 20,
        file_name: format!("{text}.mcap"),
        outcome: Outcome::Failure,
        cohort: "night".into(),
    }
}

fn export() -> Job {
    Job {
        id: JobId::new(),
        task_id: TaskId::new(),
        spec: JobSpec::Export { dataset_id: DatasetId::new(), spec: Default::default() },
        state: JobState::Running,
        priority: 0,
        result_id: "exp".into(),
        done: 0,
        total: 0,
        message: String::new(),
        error: String::new(),
        attempt: 1,
        max_attempts: 3,
        placement: crate::placement::Placement::default(),
        cancel_requested: false,
        checkpoint: None,
        checkpoint_step: None,
        peak_memory_bytes: 0,
        needs: Vec::new(),
        waits_for: Vec::new(),
        key: String::new(),
        engine_options: String::new(),
        created_at: Millis(0),
        started_at: None,
        ended_at: None,
    }
}

#[test]
fn an_assignment_survives_the_wire() {
    let expert = input("expert");
    let nearest = Nearest { episode_id: expert.id.clone(), end_step: 4 };
    let segments = vec![
        KeptSegment { end_step: 3, weight: 0.95, nearest: Some(nearest) },
        KeptSegment { end_step: 4, weight: 0.9, nearest: None },
    ];
    let base = FrozenRun { lo: -2.0, hi: -0.5, quantiles: vec![-2.0, -0.5], expert_ids: vec![expert.id.clone()] };
    let task = crate::proto::task::tests::spec();
    let inputs = Inputs {
        task,
        experts: vec![expert],
        imperfect: vec![input("imperfect")],
        kept: vec![KeptInput { episode: input("kept"), segments, similarities: vec![-0.5], qualities: vec![0.95] }],
        encoder: Some(blob("encoder")),
        checkpoint: None,
        segment_length: 6,
        origin: [("run".to_owned(), "run_1".to_owned())].into(),
        policy: Some(blob("policy")),
        base: Some(base),
    };
    let job = export();
    let (id, order, mut read) = assigned(assignment(job.clone(), inputs.clone())).unwrap();
    assert!(read.experts.is_empty() && read.imperfect.is_empty() && read.kept.is_empty());
    let Inputs { experts, imperfect, kept, .. } = inputs.clone();
    for part in [InputPart::Experts(experts), InputPart::Imperfect(imperfect), InputPart::Kept(kept)] {
        episodes_from(episodes(part)).unwrap().into_iter().for_each(|part| read.add(part));
    }
    assert_eq!((id, read), (job.id, inputs));
    assert!(matches!(order, JobOrder::Export { .. }));
}

/// A message has up to 100,000 segments of several episodes, or one episode with more.
#[test]
fn a_part_of_the_kept_steps_is_far_below_the_limit_of_a_message() {
    let (expert, steps) = (EpisodeId::new(), 100_000_u32);
    let nearest = Some(Nearest { episode_id: expert, end_step: steps });
    let segment = |end_step| KeptSegment { end_step, weight: 0.95, nearest: nearest.clone() };
    let (similarities, qualities) = (vec![-0.5; 100_000], vec![0.95; 100_000]);
    let kept =
        KeptInput { episode: input("kept"), segments: (0..steps).map(segment).collect(), similarities, qualities };
    let mut message = episodes(InputPart::Kept(vec![kept]));
    assert!(message.encoded_len() < 4 << 20, "{}", message.encoded_len());
    message.kept[0].match_episodes[7] = 2;
    let error = episodes_from(message).unwrap_err();
    assert!(error.message().starts_with("kept.match_episodes: "), "{error}");
}

#[test]
fn progress_round_trips_and_non_finite_metrics_are_rejected() {
    let progress_sent = Progress {
        done: 3,
        total: 9,
        message: "training".into(),
        metrics: vec![(3, "loss".into(), 0.5)],
        peak_memory_bytes: 77,
    };
    assert_eq!(progress_request(progress(progress_sent.clone())).unwrap(), progress_sent);
    let broken = Progress { metrics: vec![(3, "loss".into(), f64::NAN)], ..progress_sent };
    let error = progress_request(progress(broken)).unwrap_err();
    assert!(error.message().starts_with("metrics[0].value: "), "{error}");
}

#[test]
fn a_long_error_is_shortened() {
    let (error, retry) = fail_request(v1::FailJobRequest { error: "ü".repeat(9000), retry: true });
    assert_eq!((error.chars().count(), retry), (LONGEST_ERROR, true));
}

#[test]
fn base_scores_survive_the_wire_without_q() {
    let scores = EpisodeScores {
        episode_id: EpisodeId::new(),
        role: Role::Expert,
        w: vec![-0.5, -0.75],
        q: vec![0.5, 0.25],
        match_episode: vec![0; 2],
        match_step: vec![0, 1],
        distances: vec![[0.5, 0.0, 0.5]; 2],
    };
    let read = base_scores_from(base_scores(scores.clone())).unwrap();
    assert_eq!(read, EpisodeScores { q: Vec::new(), ..scores });
}

/// Messages of workers are checked like those of any client: each wrong field of each message is named.
#[test]
fn every_wrong_field_of_a_worker_is_named() {
    use v1::complete_job_request::Message;
    let refused = |message| {
        let sent = v1::CompleteJobRequest { message: Some(message) };
        Completion::default().push(sent).unwrap_err().message().to_owned()
    };
    let digest = || blob("x").to_string();
    let policy = |blob: String, kind: &str| Message::Policy(v1::PolicyResult { blob, kind: kind.into() });
    let file = |name: &str, blob: String| {
        Message::Export(v1::ExportResult { files: vec![v1::ExportedFile { name: name.into(), blob, size_bytes: 1 }] })
    };
    let right = v1::ScoreResult::default();
    let score = |spoil: fn(&mut v1::ScoreResult)| {
        let mut result = right.clone();
        spoil(&mut result);
        Message::Score(result)
    };
    for address in ["", "lab", "10.0.0.5", "10.0.0.5:99999"] {
        let error = meeting_request(v1::ReportMeetingRequest { address: address.into() }).unwrap_err();
        assert!(error.message().starts_with("address: "), "{error}");
    }
    let found = |address: &str| meeting(v1::GetMeetingResponse { address: address.into() }).unwrap();
    assert_eq!((found("10.0.0.5:4"), found("")), (Some("10.0.0.5:4".parse().unwrap()), None));
    for (message, field) in [
        (Message::Encoder(v1::EncoderResult { blob: "../x".into() }), "message.encoder.blob: "),
        (policy(String::new(), "bc"), "message.policy.blob: "),
        (policy(digest(), ""), "message.policy.kind: "),
        (file("a/../b", digest()), "message.export.files.name: "),
        (file("a", "b".into()), "message.export.files.blob: "),
        (score(|r| r.lo = f64::NAN), "message.score: "),
        (score(|r| r.hi = f64::INFINITY), "message.score: "),
        (score(|r| r.quantiles = vec![1.0, 0.0]), "message.score: "),
        (score(|r| r.expert_ids = vec!["x".into()]), "message.score.expert_ids: "),
        (Message::Evaluation(v1::EvaluationResult { seeds: Vec::new() }), "message.evaluation.seeds: "),
        (Message::EpisodeScores(v1::EpisodeScores::default()), "message.episode_scores: must follow"),
    ] {
        let progress_sent = refused(message);
        assert!(progress_sent.starts_with(field), "{field} expected in {progress_sent:?}");
    }
    assert!(checkpoint_request(v1::SaveCheckpointRequest { step: 1, blob: "x".into() }).is_err());
    for wrong in ["", "x", "../../lock"] {
        let located = locate_request(v1::LocateBlobRequest { blob: wrong.into(), ..Default::default() }).unwrap_err();
        let stored = store_request(v1::StoreBlobRequest { blob: wrong.into() }).unwrap_err();
        assert!(located.message().starts_with("blob: ") && stored.message().starts_with("blob: "), "{wrong}");
    }
    let request = v1::LocateBlobRequest { blob: digest(), accept_url: true, fetch: false };
    let query = BlobQuery { blob: blob("x"), accept_url: true, fetch: false };
    assert_eq!(locate_request(request).unwrap(), query);
    let metric = |name: &str| v1::Metric { step: 1, name: name.into(), value: 0.5 };
    let progress = |spoil: fn(&mut v1::ReportProgressRequest)| {
        let mut request = v1::ReportProgressRequest { metrics: vec![metric("loss")], ..Default::default() };
        spoil(&mut request);
        progress_request(request).unwrap_err().message().to_owned()
    };
    assert!(progress(|r| r.message = "a\nb".into()).starts_with("message: "));
    assert!(progress(|r| r.metrics[0].name.clear()).starts_with("metrics[0].name: "));
}

#[test]
fn every_wrong_field_of_an_episodes_scores_is_named() {
    let right = v1::EpisodeScores {
        episode_id: EpisodeId::new().into(),
        role: v1::Role::Imperfect.into(),
        ..v1::EpisodeScores::default()
    };
    let refused = |spoil: fn(&mut v1::EpisodeScores)| {
        let mut scores = right.clone();
        spoil(&mut scores);
        completion::scores_from(scores).unwrap_err().message().to_owned()
    };
    assert!(completion::scores_from(right.clone()).is_ok());
    assert!(refused(|s| s.episode_id = "x".into()).starts_with("message.episode_scores.episode_id: "));
    assert!(refused(|s| s.role = 0).starts_with("message.episode_scores.role: "));
    assert!(refused(|s| s.distance_m.push(0.5)).starts_with("message.episode_scores: the three distances"));
}
