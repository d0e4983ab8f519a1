//! Crashes under load: the server is killed at random moments and at its fail points while many clients use it. Every
//! acknowledged change survives, no partial change is visible, and every job ends.
//!
//! Short here; `make crash-test` is the long form.

mod checkpoint;
mod import;
mod resend;
mod sweep;
mod sync_order;
mod training;

use gleaner_bucket::testing::TestStore;

use crate::support::{
    blob_store,
    crash::{Settings, check, kills, lab::Lab, load},
    server::TestServer,
};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn acknowledged_changes_survive_every_crash() {
    changes_survive(TestServer::start().await).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn acknowledged_changes_survive_every_crash_with_a_bucket() {
    let Some(store) = TestStore::start().unwrap() else { return };
    changes_survive(blob_store::start(&store, "crash", &[]).await).await;
}

async fn changes_survive(mut server: TestServer) {
    let settings = Settings::read();
    let lab = Lab::set_up(&server, settings).await;
    let mut load = load::start(&lab);
    let report = kills::run(&mut server, &lab, &mut load).await;
    load.end().await;
    check::everything(&lab).await;
    eprintln!("{report}\n{}", lab.ledger.summary());

    assert!(server.stop().await, "a stop on request is a success");
    check::expect_clear_folders(server.data_dir());
    check::expect_sound(server.data_dir()).await;
    report.expect_complete(&settings);
}
