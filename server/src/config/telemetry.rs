//! Where the server tells of itself, logs aside.

use std::net::SocketAddr;

use clap::Args;

/// Where the server tells of itself, logs aside.
#[derive(Debug, Clone, Default, Args)]
pub struct TelemetryConfig {
    /// Address of the curation pages, of /metrics for Prometheus and of /healthz. Off unless given. Encrypted, and asking
    /// for tokens, as calls are.
    #[arg(long, env = "GLEANER_WEB_LISTEN", value_name = "ADDRESS")]
    pub web_listen: Option<SocketAddr>,
    /// Show the pages on an address other machines can reach without encryption: who listens on the way can sign in too.
    #[arg(long, env = "GLEANER_WEB_INSECURE")]
    pub web_insecure: bool,
    /// OpenTelemetry collector (OTLP over gRPC) to send the spans of calls, sessions and jobs to, such as
    /// http://127.0.0.1:4317. Off unless given.
    #[arg(long, env = "GLEANER_OTLP_ENDPOINT", value_name = "URL")]
    pub otlp_endpoint: Option<String>,
}

impl TelemetryConfig {
    /// Checks that pages which other machines can reach are encrypted; tokens are asked for there anyway, but with
    /// --insecure.
    ///
    /// # Errors
    /// A sentence that names the flag and the mend.
    pub fn validate(&self, encrypted: bool) -> Result<(), String> {
        match self.web_listen {
            Some(address) if !address.ip().is_loopback() && !encrypted && !self.web_insecure => Err(format!(
                "--web-listen {address}: other machines can reach this address: encrypt with --tls-cert and --tls-key, \
                 or listen on 127.0.0.1, or accept the risk with --web-insecure"
            )),
            Some(_) | None => Ok(()),
        }
    }
}
