//! A short load test: well-behaved clients have no failure beside hostile ones, and every held connection ends. Response times
//! are measured by the long form on an idle machine.

use gleaner_bench_load::{Options, run};

use crate::support::process::SERVER;

/// The longest life of an unused connection or a slow upload, in seconds.
const LONGEST_HELD: f64 = 10.0;

#[tokio::test]
async fn good_clients_are_served_beside_hostile_ones() {
    let options = Options {
        server_bin: SERVER.into(),
        seconds: 2,
        uploaders: 2,
        queriers: 6,
        robots: 2,
        upload_every: 1.0,
        query_every: 0.1,
        observe_every: 0.1,
        silent: 50,
        slow_uploads: 5,
        server_flags: ["--first-call-seconds", "2", "--slow-seconds", "2"].map(str::to_owned).to_vec(),
        out: None,
    };
    let report = run(&options).await.unwrap();
    let (failed, reasons) = report.failures();
    assert_eq!(failed, 0, "{reasons:?}");
    assert!(report.held_at_most() <= LONGEST_HELD, "{} s", report.held_at_most());
    assert!(report.calls() > 20, "{}", report.calls());
}
