//! The metrics: names, descriptions, and the recorder behind `/metrics`.

use std::{sync::OnceLock, time::Duration};

use metrics::{Unit, counter, describe_counter, describe_gauge, describe_histogram, histogram};
use metrics_exporter_prometheus::{BuildError, Matcher, PrometheusBuilder, PrometheusHandle};
use tonic::Code;

use crate::{
    domain::observation::SessionOutput,
    error::{Error, Result},
};

/// Upper bounds of the histogram of calls, in seconds.
const SECONDS: [f64; 14] = [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 60.0, 600.0];
/// Upper bounds of the histogram of batches, in observations.
const BATCHES: [f64; 7] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];
/// Quantiles of sessions' latencies over the last minute.
const PERCENTILES: [f64; 4] = [0.5, 0.9, 0.99, 0.999];

/// The recorder of this process, installed at the first call.
///
/// # Errors
/// Internal when another recorder is installed already.
pub(crate) fn recorder() -> Result<PrometheusHandle> {
    static HANDLE: OnceLock<std::result::Result<PrometheusHandle, String>> = OnceLock::new();
    let made = HANDLE.get_or_init(|| install().map_err(|error| error.to_string()));
    made.clone().map_err(|error| Error::internal("setting up metrics", error))
}

fn install() -> std::result::Result<PrometheusHandle, BuildError> {
    let handle = PrometheusBuilder::new()
        .set_buckets_for_metric(Matcher::Full("gleaner_rpc_seconds".to_owned()), &SECONDS)?
        .set_buckets_for_metric(Matcher::Full("gleaner_policy_batch_size".to_owned()), &BATCHES)?
        .set_quantiles(&PERCENTILES)?
        .install_recorder()?;
    describe();
    Ok(handle)
}

fn describe() {
    describe_histogram!("gleaner_rpc_seconds", Unit::Seconds, "Calls, by method and code, from first byte to last");
    describe_counter!("gleaner_upload_bytes_total", Unit::Bytes, "Bytes of uploaded recordings");
    describe_gauge!("gleaner_connections", "Open connections");
    describe_counter!("gleaner_connections_refused_total", "Connections refused by a limit");
    describe_counter!("gleaner_connections_closed_total", "Connections closed for a silent or slow peer");
    describe_counter!("gleaner_calls_refused_total", "Calls refused or ended by a limit of their client");
    describe_gauge!("gleaner_jobs", "Jobs by state");
    describe_gauge!("gleaner_queue_age_seconds", Unit::Seconds, "Age of the oldest queued job");
    describe_gauge!("gleaner_worker_memory_bytes", Unit::Bytes, "Resident memory of workers, by kind of job");
    describe_histogram!(
        "gleaner_session_seconds",
        Unit::Seconds,
        "Time from an observation to its action, by deployment"
    );
    describe_histogram!("gleaner_policy_batch_size", "Observations in one pass of a model");
    describe_counter!("gleaner_observations_total", "Observations of sessions, by deployment and outcome");
    describe_gauge!("gleaner_disk_free_bytes", Unit::Bytes, "Free bytes on the data folder's file system");
    describe_gauge!("gleaner_disk_size_bytes", Unit::Bytes, "Size of the data folder's file system");
    describe_gauge!("gleaner_memory_bytes", Unit::Bytes, "Resident memory of the server");
}

/// Records the end of a call.
pub(super) fn rpc(method: &'static str, ended: Code, took: Duration) {
    histogram!("gleaner_rpc_seconds", "method" => method, "code" => code(ended)).record(took.as_secs_f64());
}

/// Records received bytes of a recording.
pub(crate) fn uploaded(bytes: usize) {
    counter!("gleaner_upload_bytes_total").increment(bytes as u64);
}

/// The metrics of one session, labelled with its deployment.
#[derive(Debug, Clone)]
pub(crate) struct SessionMetrics {
    deployment: String,
}

impl SessionMetrics {
    /// For a session of an existing deployment.
    pub(crate) fn new(deployment: String) -> Self {
        Self { deployment }
    }

    /// Counts an output to the robot.
    pub(crate) fn record(&self, output: &SessionOutput) {
        match output {
            SessionOutput::Action { acted, dropped, .. } => {
                let timings = &acted.timings;
                let latency = Duration::from_micros(timings.total_us).as_secs_f64();
                histogram!("gleaner_session_seconds", "deployment" => self.deployment.clone()).record(latency);
                histogram!("gleaner_policy_batch_size").record(f64::from(timings.batch_size));
                self.count("answered", 1);
                self.count("dropped", *dropped);
            }
            SessionOutput::Missed { dropped, .. } => {
                self.count("missed", 1);
                self.count("dropped", *dropped);
            }
            SessionOutput::Opened { .. } | SessionOutput::Draining { .. } | SessionOutput::Closed { .. } => {}
        }
    }

    fn count(&self, outcome: &'static str, observations: u64) {
        if observations > 0 {
            counter!("gleaner_observations_total", "deployment" => self.deployment.clone(), "outcome" => outcome)
                .increment(observations);
        }
    }
}

/// The name of a code in gRPC.
pub(super) fn code(code: Code) -> &'static str {
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}
