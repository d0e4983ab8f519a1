//! The objects of the load: a task with a core of episodes, an encoder, its scores, a deployed policy.

use std::{sync::Arc, time::Duration};

use gleaner_client::{Client, ClientError};
use gleaner_proto::v1::*;
use gleaner_sim::AgentSpec;
use tempfile::TempDir;
use tokio::sync::watch;
use tonic::Status;

use super::{Settings, ledger::Ledger};
use crate::support::{
    api::Api,
    lab::{self, Recording},
    server::TestServer,
};

/// The cohort of the load's uploads; the core has others.
pub const COHORT: &str = "load";
/// The deployment of the sessions.
pub const DEPLOYMENT: &str = "pick_cube@crash";

/// The state that the clients of the load share.
pub struct Lab {
    pub settings: Settings,
    pub client: Client,
    pub api: Api,
    pub ledger: Ledger,
    /// The folder of recordings that are pushed.
    pub recordings: TempDir,
    /// The snapshot of the core.
    pub snapshot: String,
    pub encoder: String,
    pub run: String,
    /// The messages that import scores of the core's snapshot.
    pub import: Vec<ImportScoresRequest>,
    /// The number of uploads that may start by now, so that some remain until the last kill.
    pub due: watch::Sender<u64>,
    /// The number of restarts of the server.
    pub lives: watch::Sender<u64>,
}

impl Lab {
    /// Creates everything before the first kill.
    pub async fn set_up(server: &TestServer, settings: Settings) -> Arc<Self> {
        let mut api = Api::connect(server).await;
        let ledger = Ledger::default();
        for episode in lab::set_up(&mut api).await {
            ledger.add_attempt(&episode.blake3);
            ledger.add_episode(&episode);
        }
        let pretrain = api.succeed(lab::TASK, lab::pretrain(3)).await;
        let Some(job_spec::Spec::Pretrain(spec)) = pretrain.spec.unwrap().spec else { panic!("not pretrain") };
        let encoder = pretrain.result_id;
        let run = api.succeed(lab::TASK, lab::score(&encoder)).await.result_id;
        let policy = api.succeed(lab::TASK, lab::train(train_spec::Data::ExpertsOf(encoder.clone()), 3)).await;
        api.deploy(DEPLOYMENT, &policy.result_id).await;
        ledger.add_policy(policy.result_id);
        let client = Client::connect(server.url(), None).await.unwrap();
        let recordings = tempfile::tempdir().unwrap();
        let (snapshot, due, lives) = (spec.snapshot_id, watch::Sender::new(0), watch::Sender::new(0));
        let import = lab::import(&mut api, &snapshot, "").await;
        Arc::new(Self { settings, client, api, ledger, recordings, snapshot, encoder, run, import, due, lives })
    }

    /// Pretraining on the core, independent of the number of episodes.
    pub fn pretrain(&self, steps: u32) -> job_spec::Spec {
        let often = lab::with(lab::pretrain(steps), serde_json::json!({"checkpoint_every": 2}));
        let job_spec::Spec::Pretrain(spec) = often else { panic!("not pretrain") };
        job_spec::Spec::Pretrain(PretrainSpec { snapshot_id: self.snapshot.clone(), ..spec })
    }

    /// A scoring of the core only, because episodes in a snapshot cannot be deleted.
    pub fn score(&self) -> job_spec::Spec {
        let (encoder_id, snapshot_id) = (self.encoder.clone(), self.snapshot.clone());
        job_spec::Spec::Score(ScoreSpec { encoder_id, snapshot_id, ..ScoreSpec::default() })
    }
}

/// The n-th recording of the load.
pub async fn recording(seed: u64, n: u64) -> Recording {
    let made = tokio::task::spawn_blocking(move || {
        let (agent, outcome) =
            if n.is_multiple_of(2) { ("expert", Outcome::Success) } else { ("early_release:1.0", Outcome::Failure) };
        let agent: AgentSpec = agent.parse().unwrap();
        lab::record(agent, outcome, 1_000_000 * (seed % 1000 + 1) + n)
    });
    Recording { cohort: COHORT.to_owned(), ..made.await.unwrap() }
}

/// Whether a call failed because the server was gone; any other error fails the test.
pub fn was_gone(status: &Status) -> bool {
    ClientError::from(status.clone()).is_transient()
}

/// The pause between the changes of a client, and the longest wait before a retry.
const PAUSE: Duration = Duration::from_millis(100);

/// Waits for the next start of the server, at most for the pause of the clients.
pub async fn next_life(lab: &Lab) {
    changed(&mut lab.lives.subscribe()).await;
}

/// Waits for a change of the number of starts, at most for the pause of the clients.
pub async fn changed(lives: &mut watch::Receiver<u64>) {
    let _ = tokio::time::timeout(PAUSE, lives.changed()).await;
}

/// Retries a call until the server has responded: `retry!(lab, jobs.cancel_job(request))`.
macro_rules! retry {
    ($lab:expr, $service:ident.$call:ident($request:expr)) => {
        loop {
            match $lab.api.clone().$service.$call($request.clone()).await {
                Err(status) if $crate::support::crash::lab::was_gone(&status) => {
                    $crate::support::crash::lab::next_life(&$lab).await
                }
                response => break response,
            }
        }
    };
}
pub(crate) use retry;
