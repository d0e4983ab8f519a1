//! Where the server tells of itself, logs aside.

use std::net::SocketAddr;

use clap::Args;

/// Where the server tells of itself, logs aside.
#[derive(Debug, Clone, Default, Args)]
pub struct TelemetryConfig {
    /// Address of the pages for machines: /metrics for Prometheus, and /healthz. Off unless given.
    #[arg(long, env = "GLEANER_WEB_LISTEN", value_name = "ADDRESS")]
    pub web_listen: Option<SocketAddr>,
    /// Show those pages on an address other machines can reach, although nobody is asked there who they are.
    #[arg(long, env = "GLEANER_WEB_INSECURE")]
    pub web_insecure: bool,
    /// OpenTelemetry collector (OTLP over gRPC) to send the spans of calls, sessions and jobs to, such as
    /// http://127.0.0.1:4317. Off unless given.
    #[arg(long, env = "GLEANER_OTLP_ENDPOINT", value_name = "URL")]
    pub otlp_endpoint: Option<String>,
}

impl TelemetryConfig {
    /// Checks what the types cannot tell.
    ///
    /// # Errors
    /// A sentence that names the flag and the mend.
    pub fn validate(&self) -> Result<(), String> {
        match self.web_listen {
            Some(address) if !address.ip().is_loopback() && !self.web_insecure => Err(format!(
                "--web-listen {address}: other machines can reach this address, and nobody is asked who they are \
                 there. Listen on 127.0.0.1, or accept the risk with --web-insecure"
            )),
            Some(_) | None => Ok(()),
        }
    }
}
