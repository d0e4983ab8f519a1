//! Silence, stops and the processes of an attempt, by the clock of the tests.

use super::*;

fn attempt() -> Attempt {
    Attempt { job_id: JobId::new(), token_hash: "hash".to_owned() }
}

#[tokio::test(start_paused = true)]
async fn a_report_resets_the_silence() {
    let leases = Leases::new(CancellationToken::new());
    let (attempt, begun) = (attempt(), Instant::now());
    let lease = leases.grant(&attempt, Tie::Child);
    let limit = Duration::from_secs(120);
    let words = async {
        tokio::time::sleep(Duration::from_secs(100)).await;
        leases.renew(&attempt);
        std::future::pending::<()>().await;
    };
    tokio::select! {
        () = lease.silent_for(limit) => {}
        () = words => {}
    }
    assert_eq!(begun.elapsed().as_secs(), 220);
}

#[tokio::test(start_paused = true)]
async fn the_largest_limit_never_ends_an_attempt() {
    let lease = Leases::new(CancellationToken::new()).grant(&attempt(), Tie::Child);
    let day = Duration::from_secs(24 * 60 * 60);
    assert!(tokio::time::timeout(day, lease.silent_for(Duration::from_secs(u64::MAX))).await.is_err());
}

#[tokio::test(start_paused = true)]
async fn a_worker_is_not_silent_while_its_call_is_answered() {
    let leases = Leases::new(CancellationToken::new());
    let (attempt, begun) = (attempt(), Instant::now());
    let lease = leases.grant(&attempt, Tie::Child);
    let call = async {
        leases.renew_during(&attempt, tokio::time::sleep(Duration::from_secs(1000))).await;
        pending::<()>().await;
    };
    tokio::select! {
        () = lease.silent_for(Duration::from_secs(120)) => {}
        () = call => {}
    }
    assert!((1119..=1120).contains(&begun.elapsed().as_secs()), "{:?}", begun.elapsed());
}

#[test]
fn one_job_is_stopped_and_then_all() {
    let stopping = CancellationToken::new();
    let leases = Leases::new(stopping.clone());
    let (one, other) = (attempt(), attempt());
    let (_a, _b) = (leases.grant(&one, Tie::Child), leases.grant(&other, Tie::Child));
    leases.stop(&one.job_id);
    assert!(leases.stopped(&one) && !leases.stopped(&other));
    stopping.cancel();
    assert!(leases.stopped(&other));
    leases.end(&other);
    assert!(!leases.stopped(&other));
}

#[tokio::test(start_paused = true)]
async fn a_late_worker_is_silent_only_after_its_first_call() {
    let leases = Leases::new(CancellationToken::new());
    let (attempt, begun) = (attempt(), Instant::now());
    let lease = leases.grant(&attempt, Tie::Remote);
    let first_call = async {
        tokio::time::sleep(Duration::from_secs(1000)).await;
        assert!(!lease.begun());
        leases.renew(&attempt);
        std::future::pending::<()>().await;
    };
    tokio::select! {
        () = lease.silent_for(Duration::from_secs(120)) => {}
        () = first_call => {}
    }
    assert_eq!(begun.elapsed().as_secs(), 1120);
}

#[test]
fn a_remote_worker_is_not_stopped_with_the_server() {
    let stopping = CancellationToken::new();
    let leases = Leases::new(stopping.clone());
    let attempt = attempt();
    let lease = leases.grant(&attempt, Tie::Remote);
    stopping.cancel();
    assert!(!leases.stopped(&attempt));
    leases.stop(&attempt.job_id);
    assert!(leases.stopped(&attempt) && !lease.contested() && !lease.delivered.is_cancelled());
    leases.contest(&attempt);
    leases.deliver(&attempt);
    assert!(lease.contested() && lease.delivered.is_cancelled());
}

#[tokio::test]
async fn the_first_process_of_each_rank_is_admitted_and_meets_rank_0() {
    let leases = Leases::new(CancellationToken::new());
    let attempt = attempt();
    assert!(!leases.admit(&attempt, 1, "a"), "the attempt has no lease");
    let _lease = leases.grant(&attempt, Tie::Child);
    assert!(leases.admit(&attempt, 1, "a") && leases.admit(&attempt, 1, "a") && leases.admit(&attempt, 2, "b"));
    assert!(!leases.admit(&attempt, 1, "b"));
    let address: SocketAddr = "10.0.0.5:41234".parse().unwrap();
    let (found, ()) = tokio::join!(leases.meeting(&attempt), async { leases.meet(&attempt, address) });
    assert_eq!(found, address);
}
