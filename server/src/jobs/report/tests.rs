//! Which processes may speak for an attempt.

use gleaner_core::PretrainSpec;

use super::*;
use crate::{
    domain::{
        order::{JobOrder, Queueing},
        snapshot::RoleRule,
    },
    jobs::{lease::Tie, testing::Bench, token::Issuer},
};

async fn submit(bench: &Bench) {
    let order = JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec: PretrainSpec::default() };
    bench.jobs.submit(&bench.task.id, order, Queueing::default()).await.unwrap();
}

/// A worker's words in a call.
fn caller(process: &str, rank: u32) -> Caller<'_> {
    Caller { process, node: "", rank }
}

#[tokio::test]
async fn each_rank_of_an_attempt_is_one_process_and_rank_0_reports_where_it_waits() {
    let bench = Bench::new().await;
    submit(&bench).await;
    let issuer = Issuer::new();
    let job = bench.store.claim_job(&issuer.hash, "local").await.unwrap().unwrap();
    let (token, attempt) = (issuer.token(&job.id), issuer.attempt(&job.id));
    let lease = bench.jobs.0.leases.grant(&attempt, Tie::Remote);
    let known =
        async |process, rank| bench.jobs.authenticate(token.reveal(), &caller(process, rank)).await.unwrap().is_some();
    assert!(known("b", 1).await && !lease.begun(), "a rank above 0 is no sign of life");
    assert!(known("a", 0).await && lease.begun() && known("c", 2).await && known("b", 1).await && !lease.contested());
    assert!(!known("c", 1).await && lease.contested(), "a second process of a rank");
    let address = "10.0.0.5:41234".parse().unwrap();
    bench.jobs.report_meeting(&attempt, address);
    assert_eq!(bench.jobs.meeting(&attempt).await, Some(address));
    bench.jobs.fail(&attempt, "no".into(), false).await.unwrap();
    assert!(!known("b", 1).await, "the attempt is over");
}

#[tokio::test]
async fn a_part_of_a_result_is_a_sign_of_life() {
    let bench = Bench::new().await;
    submit(&bench).await;
    let issuer = Issuer::new();
    let job = bench.store.claim_job(&issuer.hash, "local").await.unwrap().unwrap();
    let attempt = issuer.attempt(&job.id);
    let lease = bench.jobs.0.leases.grant(&attempt, Tie::Remote);
    assert!(!lease.begun());
    bench.jobs.renew(&attempt);
    assert!(lease.begun());
}

#[tokio::test]
async fn only_the_token_of_a_running_attempt_is_accepted() {
    let bench = Bench::new().await;
    submit(&bench).await;
    let issuer = Issuer::new();
    let job = bench.store.claim_job(&issuer.hash, "local").await.unwrap().unwrap();
    let token = issuer.token(&job.id);
    let (attempt, known) = bench.jobs.authenticate(token.reveal(), &caller("one", 0)).await.unwrap().unwrap();
    assert_eq!(known.id, job.id);
    assert!(
        bench.jobs.authenticate(token.reveal(), &caller("two", 0)).await.unwrap().is_none(),
        "one process has the attempt"
    );
    assert!(
        bench.jobs.authenticate(token.reveal(), &caller("two", 1)).await.unwrap().is_none(),
        "it has no lease here"
    );
    let forged = Issuer::new().token(&job.id);
    assert!(bench.jobs.authenticate(forged.reveal(), &caller("one", 0)).await.unwrap().is_none());
    assert!(bench.jobs.authenticate("", &caller("one", 0)).await.unwrap().is_none());
    bench.jobs.fail(&attempt, "no".into(), false).await.unwrap();
    assert!(bench.jobs.authenticate(token.reveal(), &caller("one", 0)).await.unwrap().is_none());
}

#[tokio::test]
async fn storing_a_result_counts_as_signs_of_life() {
    let bench = Bench::new().await;
    submit(&bench).await;
    let (attempt, job) = bench.claim().await;
    let lease = bench.jobs.0.leases.grant(&attempt, Tie::Remote);
    let absent = BlobId::from(blake3::hash(b"absent"));
    let refused = bench.jobs.complete(&attempt, &job, Made::Encoder { checkpoint: absent }).await.unwrap_err();
    assert_eq!(refused.kind(), Kind::NotFound);
    assert!(lease.begun(), "the call of complete itself was not authenticated here");
}
