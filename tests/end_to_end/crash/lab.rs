//! What the load works on: a task with a core of episodes, an encoder, its scores, a policy in force.

use std::{sync::Arc, time::Duration};

use gleaner_client::{Client, ClientError};
use gleaner_proto::v1::*;
use gleaner_sim::AgentSpec;
use tempfile::TempDir;
use tokio::sync::watch;
use tonic::Status;

use super::{Settings, ledger::Ledger};
use crate::{
    api::Api,
    lab::{self, Recording},
    server::TestServer,
};

/// The cohort of what the load uploads; the core has others.
pub const COHORT: &str = "load";
/// The deployment that sessions are opened on.
pub const DEPLOYMENT: &str = "pick_cube@crash";

/// Everything that the clients of the load share.
pub struct Lab {
    pub settings: Settings,
    pub client: Client,
    pub api: Api,
    pub ledger: Ledger,
    /// Where recordings lie until they are pushed.
    pub recordings: TempDir,
    /// The snapshot of the core.
    pub snapshot: String,
    pub encoder: String,
    pub run: String,
    /// Uploads that may begin by now, so that there are some to the last kill.
    pub due: watch::Sender<u64>,
    /// How often the server has begun to listen again.
    pub lives: watch::Sender<u64>,
}

impl Lab {
    /// Everything is acknowledged before the first kill.
    pub async fn set_up(server: &TestServer, settings: Settings) -> Arc<Self> {
        let mut api = Api::connect(server).await;
        let ledger = Ledger::default();
        for episode in lab::set_up(&mut api).await {
            ledger.attempts(&episode.blake3);
            ledger.stored(&episode);
        }
        let pretrain = api.succeed(lab::TASK, lab::pretrain(3)).await;
        let Some(job_spec::Spec::Pretrain(spec)) = pretrain.spec.unwrap().spec else { panic!("not pretrain") };
        let encoder = pretrain.result_id;
        let run = api.succeed(lab::TASK, lab::score(&encoder)).await.result_id;
        let policy = api.succeed(lab::TASK, lab::train(train_spec::Data::ExpertsOf(encoder.clone()), 3)).await;
        api.policies
            .deploy(DeployRequest {
                name: DEPLOYMENT.into(),
                policy_id: policy.result_id.clone(),
                ..DeployRequest::default()
            })
            .await
            .unwrap();
        ledger.made_policy(policy.result_id);
        let client = Client::connect(server.url(), None).await.unwrap();
        let recordings = tempfile::tempdir().unwrap();
        let (snapshot, due, lives) = (spec.snapshot_id, watch::Sender::new(0), watch::Sender::new(0));
        Arc::new(Self { settings, client, api, ledger, recordings, snapshot, encoder, run, due, lives })
    }

    /// Pretraining on the core, however many episodes there are by now.
    pub fn pretrain(&self, steps: u32) -> job_spec::Spec {
        let often = lab::with(lab::pretrain(steps), serde_json::json!({"checkpoint_every": 2}));
        let job_spec::Spec::Pretrain(spec) = often else { panic!("not pretrain") };
        job_spec::Spec::Pretrain(PretrainSpec { snapshot_id: self.snapshot.clone(), ..spec })
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

/// Whether a call failed because the server was gone; any other refusal is a finding.
pub fn was_gone(status: &Status) -> bool {
    ClientError::from(status.clone()).is_transient()
}

/// The pace of clients, and the longest wait before a call is tried again.
const PACE: Duration = Duration::from_millis(100);

/// Waits for the server's next life, no longer than the clients' pace.
pub async fn next_life(lab: &Lab) {
    changed(&mut lab.lives.subscribe()).await;
}

/// Waits for a change of the server's lives, no longer than the clients' pace.
pub async fn changed(lives: &mut watch::Receiver<u64>) {
    let _ = tokio::time::timeout(PACE, lives.changed()).await;
}

/// Makes a call again until the server has answered it: `insist!(lab, jobs.cancel_job(request))`.
macro_rules! insist {
    ($lab:expr, $service:ident.$call:ident($request:expr)) => {
        loop {
            match $lab.api.clone().$service.$call($request.clone()).await {
                Err(status) if $crate::crash::lab::was_gone(&status) => $crate::crash::lab::next_life(&$lab).await,
                answered => break answered,
            }
        }
    };
}
pub(crate) use insist;
