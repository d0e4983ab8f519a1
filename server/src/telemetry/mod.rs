//! Logs, metrics and traces of the server. Must not depend on other modules; any module may call it.

pub(crate) mod memory;
pub(crate) mod metrics;
pub(crate) mod request;
mod rpc;
mod traces;

use gleaner_logs::LogOptions;
use tracing_subscriber::{layer::SubscriberExt as _, util::SubscriberInitExt as _};

pub(crate) use self::rpc::RpcLayer;
pub use self::traces::Traces;

/// Sends logs to standard error and traces to the collector at `otlp_endpoint`, if one is named. With a collector, call
/// it within the runtime that sends them, and keep the returned value until the end.
///
/// # Errors
/// A sentence when the filter or the endpoint cannot be used, or logging was set up before.
pub fn start(logs: &LogOptions, otlp_endpoint: Option<&str>) -> Result<Traces, String> {
    let (traces, layer) = Traces::to(otlp_endpoint)?;
    let result = tracing_subscriber::registry().with(logs.layer()?).with(layer).try_init();
    result.map_err(|error| error.to_string())?;
    Ok(traces)
}
