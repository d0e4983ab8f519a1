//! Logs of the server and its workers: their options, and a layer that writes events to standard error.
//!
//! Must not depend on the content of events.

use std::io::IsTerminal as _;

use clap::Args;
use gleaner_core::printable::{Escape, EscapingWriter};
use tracing::Subscriber;
use tracing_subscriber::{EnvFilter, Layer, registry::LookupSpan};

/// The heading of options that all commands have.
pub const GLOBAL: &str = "Global options";

/// What is logged, and in which form.
#[derive(Debug, Clone, Args)]
pub struct LogOptions {
    /// Log filter in the syntax of tracing, such as `debug` or `info,gleaner_server::jobs=trace`.
    #[arg(long = "log", env = "GLEANER_LOG", default_value = "info", global = true, help_heading = GLOBAL, value_name = "FILTER")]
    pub filter: String,
    /// Log in JSON, one event per line.
    #[arg(long = "log-json", env = "GLEANER_LOG_JSON", global = true, help_heading = GLOBAL)]
    pub json: bool,
}

impl LogOptions {
    /// A layer that writes events to standard error, as text or JSON lines, escaped: events contain names and messages
    /// from callers, recordings and libraries. Each event is one write, and one line. Text has colours on terminals.
    ///
    /// # Errors
    /// A sentence when the filter cannot be parsed.
    pub fn layer<S>(&self) -> Result<impl Layer<S> + use<S>, String>
    where
        S: Subscriber + for<'a> LookupSpan<'a>,
    {
        let Self { filter, json } = self;
        let filter = EnvFilter::try_new(filter).map_err(|error| format!("--log {filter:?}: {error}"))?;
        let terminal = std::io::stderr().is_terminal();
        let escape = if *json { Escape::Json } else { Escape::Field };
        let writer = move || EscapingWriter::new(std::io::stderr(), escape).with_colours(terminal);
        let logs = tracing_subscriber::fmt::layer().with_writer(writer);
        // Colours for terminals only, and not with NO_COLOR.
        let logs = if terminal { logs } else { logs.with_ansi(false) };
        let logs = if *json { logs.json().boxed() } else { logs.boxed() };
        Ok(logs.with_filter(filter))
    }
}
