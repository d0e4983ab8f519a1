//! Logs, metrics and traces of the server. Must not depend on other modules; any module may call it.

pub(crate) mod memory;
pub(crate) mod metrics;
pub(crate) mod request;
mod rpc;
mod traces;

use std::io::IsTerminal as _;

use gleaner_recording::printable::{Escape, EscapingWriter};
use tracing_subscriber::{EnvFilter, Layer as _, layer::SubscriberExt as _, util::SubscriberInitExt as _};

pub(crate) use self::rpc::RpcLayer;
pub use self::traces::Traces;

/// The outputs of telemetry.
#[derive(Debug, Clone, Copy)]
pub struct Telling<'a> {
    /// What to log, as a tracing filter.
    pub filter: &'a str,
    /// Log as JSON lines.
    pub json: bool,
    /// The address of the trace collector; `None`: traces are not sent.
    pub otlp_endpoint: Option<&'a str>,
}

/// Sends logs to standard error, as text or JSON lines, and traces to a collector if one is named. With a collector,
/// call it within the runtime that sends them, and keep the returned value until the end.
///
/// # Errors
/// A sentence when the filter or the endpoint cannot be used, or logging was set up before.
pub fn start(telling: Telling<'_>) -> Result<Traces, String> {
    let Telling { filter, json, otlp_endpoint } = telling;
    let filter = EnvFilter::try_new(filter).map_err(|error| format!("--log {filter:?}: {error}"))?;
    let terminal = std::io::stderr().is_terminal();
    // Events contain names and messages from callers, recordings and libraries. Each event is one write, and one line.
    let escape = if json { Escape::Json } else { Escape::Field };
    let writer = move || EscapingWriter::new(std::io::stderr(), escape).with_colours(terminal);
    let logs = tracing_subscriber::fmt::layer().with_writer(writer);
    // Colours for terminals only, and not with NO_COLOR.
    let logs = if terminal { logs } else { logs.with_ansi(false) };
    let logs = if json { logs.json().boxed() } else { logs.boxed() };
    let (traces, layer) = Traces::to(otlp_endpoint)?;
    let result = tracing_subscriber::registry().with(logs.with_filter(filter)).with(layer).try_init();
    result.map_err(|error| error.to_string())?;
    Ok(traces)
}
