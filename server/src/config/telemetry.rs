//! Pages, metrics and traces.

use std::net::SocketAddr;

use clap::Args;

/// Pages, metrics and traces.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Pages, metrics and traces")]
pub struct TelemetryConfig {
    /// Address of the pages, of /metrics for Prometheus and of /healthz. TLS and tokens apply as for calls. Default:
    /// off.
    #[arg(long, env = "GLEANER_WEB_LISTEN", value_name = "ADDRESS")]
    pub web_listen: Option<SocketAddr>,
    /// Allow pages without TLS on an address that other machines can reach. Eavesdroppers can then read tokens and sign
    /// in.
    #[arg(long, env = "GLEANER_WEB_INSECURE")]
    pub web_insecure: bool,
    /// Send spans of calls, sessions and jobs to this OpenTelemetry collector (OTLP over gRPC), such as
    /// http://127.0.0.1:4317. Default: off.
    #[arg(long, env = "GLEANER_OTLP_ENDPOINT", value_name = "URL")]
    pub otlp_endpoint: Option<String>,
}

impl TelemetryConfig {
    /// Checks that pages which other machines can reach have TLS; there, only --insecure turns tokens off.
    ///
    /// # Errors
    /// A sentence that names the flag and the fix.
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
