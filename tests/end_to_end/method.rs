//! The settings of the method as jobs: objectives, policies, scorers, devices.

use gleaner_proto::v1::*;
use serde_json::json;

use crate::support::{
    api::Api,
    lab,
    robot::{Robot, close, observe, start_sim, values},
    shared::shared,
};

/// Each job reports the losses of its own objectives only.
#[tokio::test]
async fn objectives_are_chosen_by_the_spec() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    for chosen in [vec!["tr"], vec!["aa", "mtp"]] {
        let changed = json!({"objectives": chosen, "shift_pixels": 1, "brightness": 0.1, "contrast": 0.1});
        let job = api.succeed(lab::TASK, lab::with(lab::pretrain(2), changed)).await;
        for objective in ["mtp", "tr", "aa"] {
            let values = api.metric(&job.id, &format!("loss_{objective}")).await;
            assert_eq!(values.len(), if chosen.contains(&objective) { 2 } else { 0 }, "{objective} of {chosen:?}");
        }
        let Some(job_spec::Spec::Pretrain(spec)) = job.spec.unwrap().spec else { panic!("not pretrain") };
        let settings = lab::given(&spec.settings);
        let listed: Vec<&str> = ["mtp", "tr", "aa"].into_iter().filter(|name| chosen.contains(name)).collect();
        assert_eq!((&settings["objectives"], &settings["shift_pixels"]), (&json!(listed), &json!(1)));
    }
}

/// Every policy that the server lists trains and acts in sessions. Policies from scratch train on experts alone; the chunks
/// of ACT have the length of their setting.
#[tokio::test]
async fn every_policy_trains_and_is_served() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let request = CreateDatasetRequest { score_run_id: shared.run.clone(), selection: Some(lab::above(0.5)) };
    let dataset = api.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap().id;
    let kinds = api.jobs.list_kinds(ListKindsRequest {}).await.unwrap().into_inner();
    for kind in kinds.policies {
        let data = match kind.name.as_str() {
            "tf_bc" => train_spec::Data::DatasetId(dataset.clone()),
            "bc" => train_spec::Data::ExpertsIn(shared.snapshot.clone()),
            _ => train_spec::Data::ExpertsOf(shared.encoder.clone()),
        };
        let mut changed = json!({"policy": kind.name});
        let mut chunk = 1;
        for (name, value) in [("segment_length", 2), ("chunk_length", 4), ("execute_length", 4)] {
            if kind.settings.iter().any(|setting| setting.name == name) {
                changed[name] = value.into();
                chunk = if name == "chunk_length" { 4 } else { chunk };
            }
        }
        if kind.name == "act" {
            changed["chunk_execution"] = "ensembled".into();
        }
        let id = api.succeed(lab::TASK, lab::with(lab::train(data, 2), changed)).await.result_id;
        let policy = api.policies().await.into_iter().find(|policy| policy.id == id).unwrap();
        assert_eq!((&policy.kind, policy.encoder_id.is_empty()), (&kind.name, !kind.needs_encoder));

        let name = format!("{}@test", kind.name);
        api.deploy(&name, &id).await;
        if ["flow", "diffusion"].contains(&kind.name.as_str()) {
            expect_executed_chunks(&mut api, &name, chunk).await;
        } else {
            expect_ensemble(&mut api, &name, chunk).await;
        }
    }
}

/// Each reply has the rest of the chunk until all of it is executed.
async fn expect_executed_chunks(api: &mut Api, name: &str, chunk: usize) {
    let mut robot = Robot::open(api, name).await.unwrap();
    assert_eq!(robot.opened.execute_length as usize, chunk);
    let mut sim = start_sim();
    let mut last: Vec<ActionStep> = Vec::new();
    for step in 0..2 * chunk {
        let actions = robot.act(observe(&sim)).await.unwrap().actions;
        assert_eq!(actions.len(), chunk - step % chunk, "{name} step {step}");
        assert_eq!(last.is_empty(), step % chunk == 0);
        assert!(last.is_empty() || actions == last, "{name} step {step}");
        sim.step(actions[0].values.as_slice().try_into().unwrap());
        last = actions[1..].to_vec();
    }
}

#[tokio::test]
async fn a_policy_that_draws_its_actions_repeats_them_under_its_seed() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let data = train_spec::Data::ExpertsIn(shared.snapshot.clone());
    let spec = lab::with(lab::train(data, 1), json!({"policy": "flow", "execute_length": 1}));
    let policy = api.succeed(lab::TASK, spec).await.result_id;
    api.deploy("draws@test", &policy).await;
    let mut drawn = Vec::new();
    for seed in [7, 7, u64::MAX] {
        let open = SessionOpen { deployment: "draws@test".into(), seed, ..SessionOpen::default() };
        let mut robot = Robot::open_with(&mut api, open).await.unwrap();
        let sim = start_sim();
        let mut chunks = Vec::new();
        for _ in 0..2 {
            chunks.push(values(&robot.act(observe(&sim)).await.unwrap().actions));
        }
        assert!(!close(&chunks[0], &chunks[1]), "each observation has a draw of its own");
        drawn.push(chunks.concat());
    }
    assert!(close(&drawn[0], &drawn[1]) && !close(&drawn[0], &drawn[2]));
}

/// The first action of a session is the ensemble of the policy's chunks so far, which `Act` returns one by one.
async fn expect_ensemble(api: &mut Api, name: &str, chunk: usize) {
    let mut robot = Robot::open(api, name).await.unwrap();
    let mut sim = start_sim();
    let mut window: Vec<Observation> = Vec::new();
    let mut chunks: Vec<Vec<ActionStep>> = Vec::new();
    for step in 0..3 {
        let mut observation = observe(&sim);
        if let Some(last) = chunks.last() {
            observation.executed_action.clone_from(&last[0].values);
        }
        window.push(observation.clone());
        let request = ActRequest { deployment: name.into(), observations: window.clone() };
        chunks.push(api.policies.act(request).await.unwrap().into_inner().actions);
        let actions = robot.act(observation).await.unwrap().actions;
        assert_eq!(actions.len(), chunk);
        for (axis, &value) in actions[0].values.iter().enumerate() {
            let predictions = chunks.iter().enumerate().filter_map(|(from, chunk)| chunk.get(step - from));
            let (mut sum, mut weights, mut weight) = (0.0, 0.0, 1.0);
            for prediction in predictions {
                sum += weight * f64::from(prediction.values[axis]);
                weights += weight;
                weight *= (-0.01_f64).exp();
            }
            assert!((f64::from(value) - sum / weights).abs() < 1e-4, "{name} step {step} axis {axis}");
        }
        sim.step(chunks[step][0].values.as_slice().try_into().unwrap());
    }
}

/// Scorers that are trained match no expert, so their segments have no match.
#[tokio::test]
async fn baseline_scorers_produce_scores() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    for scorer in ["raw", "classifier", "deminf", "progress", "vote"] {
        let matches = scorer == "raw";
        let spec = lab::with(lab::score(&shared.encoder), json!({"scorer": scorer, "normaliser": "quantile"}));
        let run = api.succeed(lab::TASK, spec).await.result_id;
        let request = GetScoreRunRequest { score_run_id: run.clone() };
        let described = api.scores.get_score_run(request).await.unwrap().into_inner().score_run.unwrap();
        let settings = lab::given(&described.settings);
        assert_eq!((&settings["scorer"], &settings["normaliser"]), (&json!(scorer), &json!("quantile")));
        for episode in &shared.episodes {
            let scores = api.episode_scores(&run, &episode.id).await;
            assert_eq!(scores.q.len() as u64, episode.steps);
            let matched = if matches { scores.q.len() } else { 0 };
            assert_eq!((scores.match_step.len(), scores.distance_o.len()), (matched, matched));
        }
        let request = CreateDatasetRequest { score_run_id: run.clone(), selection: Some(lab::top(0.1)) };
        let dataset = api.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap();
        let kept = dataset.kept_segments.unwrap();
        assert!(kept >= described.imperfect_segments.div_ceil(10), "{kept} of {}", described.imperfect_segments);
        let export = ExportSpec { dataset_id: dataset.id, format: ExportFormat::Mcap.into(), ..ExportSpec::default() };
        api.succeed(lab::TASK, job_spec::Spec::Export(export)).await;
    }
}

/// The CPU build of the tensor library has no CUDA.
#[tokio::test]
async fn missing_device_fails_the_job_without_a_retry() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let spec = lab::with(lab::score(&shared.encoder), json!({"device": "cuda"}));
    let job = api.submit(lab::TASK, spec).await.unwrap();
    let job = api.watch(&job.id).await;
    if job.state() != JobState::Succeeded {
        assert_eq!((job.state(), job.attempt), (JobState::Failed, 1));
        assert!(job.error.contains("device") && job.error.contains("use cpu"), "{}", job.error);
    }
}
