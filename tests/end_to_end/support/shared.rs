//! One server for the tests that only read or add: it has the lab's episodes, an encoder, its scores, and a deployed
//! policy.

use std::sync::{Arc, Weak};

use gleaner_proto::v1::*;
use tokio::sync::Mutex;

use super::{lab, server::TestServer};

/// The deployment of the shared policy.
pub const NAME: &str = "pick_cube@test";

/// The shared server and the ids of its artifacts.
pub struct Shared {
    pub server: TestServer,
    /// In the order of `lab::RECORDINGS`.
    pub episodes: Vec<Episode>,
    /// The snapshot of all episodes, by outcome.
    pub snapshot: String,
    pub encoder: String,
    pub run: String,
    pub policy: String,
}

/// The shared server. It ends with the last test that uses it: a static that owned it would never drop it, and the server
/// would stay behind.
pub async fn shared() -> Arc<Shared> {
    static SHARED: Mutex<Weak<Shared>> = Mutex::const_new(Weak::new());
    let mut held = SHARED.lock().await;
    if let Some(shared) = held.upgrade() {
        return shared;
    }
    let (server, mut api, episodes) =
        lab::with_episodes(&["--web-listen", "127.0.0.1:0", "--policy-servers", "127.0.0.1"]).await;
    let pretrain = api.succeed(lab::TASK, lab::pretrain(3)).await;
    let Some(job_spec::Spec::Pretrain(spec)) = pretrain.spec.unwrap().spec else { panic!("not pretrain") };
    let encoder = pretrain.result_id;
    let run = api.succeed(lab::TASK, lab::score(&encoder)).await.result_id;
    let policy = api.succeed(lab::TASK, lab::train(train_spec::Data::ExpertsOf(encoder.clone()), 3)).await.result_id;
    api.deploy(NAME, &policy).await;
    let shared = Arc::new(Shared { server, episodes, snapshot: spec.snapshot_id, encoder, run, policy });
    *held = Arc::downgrade(&shared);
    shared
}
