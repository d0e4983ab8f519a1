//! The load test, made small: good clients are served without a failure beside hostile ones, and nothing is held for ever.
//! How long calls take is for the long form, on a machine with nothing else to do.

use gleaner_bench_load::{Options, run};

/// The longest that anything may be held for nothing, in seconds.
const HELD: f64 = 10.0;

#[tokio::test]
async fn good_clients_are_served_beside_hostile_ones() {
    let options = Options {
        server_bin: env!("CARGO_BIN_EXE_gleaner-server-under-test").into(),
        seconds: 2,
        uploaders: 2,
        askers: 6,
        robots: 2,
        upload_every: 1.0,
        ask_every: 0.1,
        observe_every: 0.1,
        silent: 50,
        dripping: 5,
        server_flags: ["--first-call-seconds", "2", "--slow-seconds", "2"].map(str::to_owned).to_vec(),
        out: None,
    };
    let report = run(&options).await.unwrap();
    let (failed, reasons) = report.failures();
    assert_eq!(failed, 0, "{reasons:?}");
    assert!(report.held_at_most() <= HELD, "{} s", report.held_at_most());
    assert!(report.calls() > 20, "{}", report.calls());
}
