//! Deployments and sessions with real, tiny policies.

mod hidden;
mod moved;
mod remote;
mod score_run;

use clap::Parser as _;
use futures::channel::mpsc::{UnboundedSender, unbounded};
use gleaner_core::{ModelSpec, OptimSpec, PretrainSpec, RunSpec, TrainSpec};
use gleaner_learn::{CameraShape, Pretrained, Silent, TaskShape, Trajectory, pretrain, train_policy};
use tempfile::TempDir;
use tokio_util::sync::CancellationToken;

use super::{deploying::move_to_end, reply_sender::Answers, *};
use crate::{
    config::{Cli, Command},
    domain::{
        episode::Outcome,
        id::{PolicyId, ScoreRunId},
        observation::{CameraFrame, Image, ImageFormat, SessionInput, SessionOutput, SessionSettings},
        policy::Assignment,
        score::Encoder,
        task::Task,
    },
    error::Kind,
    ingest::Ingest,
    store::testing::{self, results},
};

/// A data folder with one task and its encoder.
struct Lab {
    dir: TempDir,
    config: Arc<ServeConfig>,
    store: Store,
    blobs: Blobs,
    scorers: Scorers,
    rollouts: Rollouts,
    task: Task,
    encoder: Encoder,
}

impl Lab {
    async fn new() -> Self {
        let (dir, store) = testing::store().await;
        let data_dir = dir.path().to_str().unwrap();
        let Command::Serve(config) =
            Cli::try_parse_from(["gleaner-server", "serve", "--policy-servers", "127.0.0.1", "--data-dir", data_dir])
                .unwrap()
                .command
        else {
            panic!("not serve");
        };
        let task = testing::task(&store).await;
        testing::episode(&store, &task, Outcome::Success, "").await;
        testing::episode(&store, &task, Outcome::Failure, "").await;
        let encoder = results::encoder(&store, &task).await;
        let blobs = Blobs::open(dir.path()).unwrap();
        let config: Arc<ServeConfig> = Arc::from(config);
        let ingest = Ingest::open(&config, store.clone(), blobs.clone()).await.unwrap();
        let scorers = Scorers::new(1, store.clone(), blobs.clone(), ingest.clone());
        let rollouts = Rollouts::open(&config, ingest).unwrap();
        Self { config, dir, store, blobs, scorers, rollouts, task, encoder }
    }

    /// The policies as after a start.
    fn policies(&self) -> Policies {
        let (scorers, rollouts) = (self.scorers.clone(), self.rollouts.clone());
        Policies::new(&self.config, self.store.clone(), self.blobs.clone(), scorers, rollouts)
    }

    async fn policy(&self, checkpoint: &[u8]) -> PolicyId {
        let blob = self.blobs.put(checkpoint).unwrap();
        results::policy(&self.store, &self.task, &self.encoder, blob).await.id
    }
}

fn shape() -> TaskShape {
    let camera = CameraShape { name: "top".into(), height: 16, width: 16, depth: false, recorded: None };
    TaskShape {
        cameras: vec![camera],
        proprioception: 2,
        action: 1,
        ranges: gleaner_core::action::ActionRanges::default(),
    }
}

/// A policy after one training step: untrained but runnable.
fn trained(seed: u64) -> Vec<u8> {
    let steps = 8u16;
    let frames = vec![100; usize::from(steps) * shape().frame_bytes()];
    let rising = |count: u16| (0..count).map(|i| f32::from(i) / 10.0).collect::<Vec<_>>();
    let episode = Trajectory::new(&shape(), "ep", frames, rising(2 * steps), rising(steps)).unwrap();
    let optim = OptimSpec { steps: 1, batch: 2, stretch: 2, ..OptimSpec::default() };
    let model = ModelSpec { segment_length: 2, ..ModelSpec::default() };
    let run = RunSpec { seed, ..RunSpec::default() };
    let spec = PretrainSpec { model, optim, run, ..PretrainSpec::default() };
    let encoder = pretrain(&shape(), std::slice::from_ref(&episode), &spec, None, None, &mut Silent).unwrap();
    let spec = TrainSpec { optim, run, ..results::finetune() };
    train_policy(&shape(), Pretrained::encoder(&encoder), &[episode], &[], &spec, None, &mut Silent).unwrap()
}

fn observation(number: u8, executed_action: &[f32]) -> Observation {
    let pixels = vec![number; shape().frame_bytes()];
    let color = Some(Image { format: ImageFormat::Raw, data: pixels.into() });
    Observation {
        stamp_ns: i64::from(number),
        cameras: vec![CameraFrame { camera: "top".into(), color, depth: None }],
        proprioception: vec![f32::from(number), 0.0],
        executed_action: executed_action.to_vec(),
        deadline: None,
        skipped_steps: 0,
    }
}

impl Policies {
    /// Whether a policy is loaded.
    fn has(&self, policy: &PolicyId) -> bool {
        lock(&self.0.loaded).has(policy)
    }
}

struct Robot {
    inputs: UnboundedSender<Result<SessionInput>>,
    outputs: Answers,
}

impl Robot {
    fn new(policies: &Policies) -> Self {
        let (inputs, sent) = unbounded();
        Self { inputs, outputs: policies.session(sent, CancellationToken::new()) }
    }

    fn sends(&self, input: SessionInput) {
        self.inputs.unbounded_send(Ok(input)).unwrap();
    }

    fn opens(&self, deployment: &str) {
        self.sends(SessionInput::Open(SessionSettings { deployment: deployment.into(), ..SessionSettings::default() }));
    }

    async fn receives(&mut self) -> Result<SessionOutput> {
        self.outputs.recv().await.unwrap()
    }

    async fn acts(&mut self, observation: Observation) -> Acted {
        self.sends(SessionInput::Observation(observation));
        let output = self.receives().await.unwrap();
        let SessionOutput::Action { acted, .. } = output else { panic!("{output:?}") };
        acted
    }
}

#[tokio::test]
async fn a_deployment_moves_while_sessions_keep_their_policy() {
    let lab = Lab::new().await;
    let (old, new) = (lab.policy(&trained(1)).await, lab.policy(&trained(2)).await);
    let policies = lab.policies();
    policies.deploy("arm", Assignment::of(&old)).await.unwrap();
    let mut robot = Robot::new(&policies);
    robot.opens("arm");
    assert!(matches!(robot.receives().await, Ok(SessionOutput::Opened { policy_id, .. }) if policy_id == old));
    let before = robot.acts(observation(1, &[])).await;

    let deployment = policies.deploy("arm", Assignment::of(&new)).await.unwrap();
    assert_eq!(deployment.policy_id(), Some(&new));
    let acted = policies.act("arm", vec![observation(1, &[])]).await.unwrap();
    assert_eq!(acted.policy_id, new);
    assert_ne!(acted.actions, before.actions);
    assert_eq!(robot.acts(observation(2, &[])).await.policy_id, old);

    robot.sends(SessionInput::Close { outcome: Outcome::Unknown });
    assert!(matches!(
        robot.receives().await,
        Ok(SessionOutput::Closed { observations: 2, dropped: 0, missed: 0, episode_id: None })
    ));
    assert!(robot.outputs.recv().await.is_none());
    assert!(!policies.has(&old), "neither a name nor a session holds it");
}

/// The distance between two answers of one action. Batches of other sizes round differently.
fn distance(left: &Acted, right: &Acted) -> f32 {
    assert_eq!((left.stamp_ns, left.actions.len(), right.actions.len()), (right.stamp_ns, 1, 1));
    (left.actions[0][0] - right.actions[0][0]).abs()
}

#[tokio::test]
async fn a_session_and_a_window_of_observations_agree() {
    let lab = Lab::new().await;
    let policy = lab.policy(&trained(1)).await;
    let policies = lab.policies();
    policies.deploy("arm", Assignment::of(&policy)).await.unwrap();
    // As after a restart: the name is stored, the policy not loaded.
    let policies = lab.policies();
    let mut robot = Robot::new(&policies);
    robot.opens("arm");
    robot.receives().await.unwrap();
    let mut window = Vec::new();
    let mut given = Vec::new();
    for number in 1..=5 {
        let acted = robot.acts(observation(number, &[])).await;
        window.push(observation(number, &given));
        assert_eq!(acted.stamp_ns, i64::from(number));
        let windowed = policies.act("arm", window.clone()).await.unwrap();
        assert!(distance(&windowed, &acted) < 1e-5, "{windowed:?} {acted:?}");
        given = acted.actions[0].clone();
        if number > 1 {
            let alone = policies.act("arm", vec![observation(number, &[])]).await.unwrap();
            assert!(distance(&alone, &acted) > 1e-4, "the history makes a difference: {alone:?} {acted:?}");
        }
    }
}

#[tokio::test]
async fn an_unreadable_checkpoint_is_not_deployed() {
    let lab = Lab::new().await;
    let good = lab.policy(&trained(1)).await;
    let torn = lab.policy(b"no checkpoint").await;
    let policies = lab.policies();
    policies.deploy("arm", Assignment::of(&good)).await.unwrap();
    let error = policies.deploy("arm", Assignment::of(&torn)).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition, "{error}");
    let acted = policies.act("arm", vec![observation(1, &[])]).await.unwrap();
    assert_eq!(acted.policy_id, good);
    let gone = results::policy(&lab.store, &lab.task, &lab.encoder, blake3::hash(b"gone").into()).await;
    assert_eq!(policies.deploy("arm", Assignment::of(&gone.id)).await.unwrap_err().kind(), Kind::Damaged);
}

#[tokio::test]
async fn unknown_names_are_not_found_and_a_session_begins_with_open() {
    let lab = Lab::new().await;
    let policies = lab.policies();
    assert_eq!(policies.act("arm", vec![observation(1, &[])]).await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(policies.deploy("arm", Assignment::of(&PolicyId::new())).await.unwrap_err().kind(), Kind::NotFound);
    let mut robot = Robot::new(&policies);
    robot.opens("arm");
    assert_eq!(robot.receives().await.unwrap_err().kind(), Kind::NotFound);
    let mut robot = Robot::new(&policies);
    robot.sends(SessionInput::Close { outcome: Outcome::Unknown });
    let error = robot.receives().await.unwrap_err();
    assert!(error.kind() == Kind::Invalid && error.message().starts_with("open: "), "{error}");
}

#[tokio::test]
async fn rolling_back_serves_the_previous_policy() {
    let lab = Lab::new().await;
    let (old, new) = (lab.policy(&trained(1)).await, lab.policy(&trained(2)).await);
    let policies = lab.policies();
    policies.deploy("arm", Assignment::of(&old)).await.unwrap();
    policies.deploy("arm", Assignment::of(&new)).await.unwrap();
    let mut robot = Robot::new(&policies);
    robot.opens("arm");
    robot.receives().await.unwrap();

    let deployment = policies.roll_back("arm").await.unwrap();
    assert_eq!((deployment.policy_id(), deployment.history.len()), (Some(&old), 3));
    assert_eq!(policies.act("arm", vec![observation(1, &[])]).await.unwrap().policy_id, old);
    assert_eq!(robot.acts(observation(1, &[])).await.policy_id, new, "a running session keeps its own");
    assert_eq!(policies.roll_back("arm").await.unwrap_err().kind(), Kind::Precondition);
    assert_eq!(policies.roll_back("leg").await.unwrap_err().kind(), Kind::NotFound);
}

#[tokio::test]
async fn policies_over_the_memory_budget_are_reloaded_on_use() {
    let mut lab = Lab::new().await;
    let (first, second) = (lab.policy(&trained(1)).await, lab.policy(&trained(2)).await);
    let config = Arc::make_mut(&mut lab.config);
    // Room for one.
    config.policies.policy_memory_bytes = u64::try_from(trained(1).len()).unwrap() * 3 / 2;
    let policies = lab.policies();
    policies.deploy("one", Assignment::of(&first)).await.unwrap();
    policies.deploy("two", Assignment::of(&second)).await.unwrap();
    assert!(!policies.has(&first), "the budget is for one");
    let mut robot = Robot::new(&policies);
    robot.opens("one");
    robot.receives().await.unwrap();
    assert!(policies.has(&first) && !policies.has(&second));
    assert_eq!(policies.act("two", vec![observation(1, &[])]).await.unwrap().policy_id, second);
    assert_eq!(robot.acts(observation(1, &[])).await.policy_id, first, "a session keeps its policy");
    robot.sends(SessionInput::Close { outcome: Outcome::Unknown });
    robot.receives().await.unwrap();
    assert!(robot.outputs.recv().await.is_none());
    assert!(!policies.has(&first) && policies.has(&second), "the least recently used was unloaded");
}

#[tokio::test]
async fn a_stop_unloads_every_policy_and_refuses_requests() {
    let lab = Lab::new().await;
    let policy = lab.policy(&trained(1)).await;
    let policies = lab.policies();
    policies.deploy("arm", Assignment::of(&policy)).await.unwrap();
    policies.stop().await;
    assert!(lock(&policies.0.loaded).named("arm").is_none());
    assert_eq!(policies.act("arm", vec![observation(1, &[])]).await.unwrap_err().kind(), Kind::Unavailable);
    drop(lab.dir);
}
