//! One server for the tests that only read or add: with the lab's episodes, an encoder, its scores, and a deployed
//! policy.

use std::sync::{Arc, Weak};

use gleaner_proto::v1::*;
use tokio::sync::Mutex;

use crate::{api::Api, lab, server::TestServer};

/// The name that the shared policy is deployed under.
pub const NAME: &str = "pick_cube@test";

/// What the tests share.
pub struct Shared {
    pub server: TestServer,
    /// In the order of `lab::RECORDINGS`.
    pub episodes: Vec<Episode>,
    /// Of all episodes, by outcome.
    pub snapshot: String,
    pub encoder: String,
    pub run: String,
    pub policy: String,
}

/// The shared server. The last test to end takes it down: what a static holds is never dropped, and a server would
/// stay behind.
pub async fn shared() -> Arc<Shared> {
    static SHARED: Mutex<Weak<Shared>> = Mutex::const_new(Weak::new());
    let mut held = SHARED.lock().await;
    if let Some(shared) = held.upgrade() {
        return shared;
    }
    let server = TestServer::start_with(&["--web-listen", "127.0.0.1:0"]).await;
    let mut api = Api::connect(&server).await;
    let episodes = lab::set_up(&mut api).await;
    let pretrain = api.succeed(lab::TASK, lab::pretrain(3)).await;
    let Some(job_spec::Spec::Pretrain(spec)) = pretrain.spec.unwrap().spec else { panic!("not pretrain") };
    let encoder = pretrain.result_id;
    let run = api.succeed(lab::TASK, lab::score(&encoder)).await.result_id;
    let policy = api.succeed(lab::TASK, lab::train(train_spec::Data::ExpertsOf(encoder.clone()), 3)).await.result_id;
    api.policies
        .deploy(DeployRequest { name: NAME.into(), policy_id: policy.clone(), ..Default::default() })
        .await
        .unwrap();
    let shared = Arc::new(Shared { server, episodes, snapshot: spec.snapshot_id, encoder, run, policy });
    *held = Arc::downgrade(&shared);
    shared
}
