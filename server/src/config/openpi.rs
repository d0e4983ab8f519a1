//! The address for clients of openpi.

use std::net::SocketAddr;

use clap::Args;

/// Clients of openpi.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Clients of openpi")]
pub struct OpenpiConfig {
    /// Address for clients of openpi, which connect to ws://ADDRESS/DEPLOYMENT and send observations as msgpack. TLS and
    /// tokens (as API keys) apply as for calls. openpi's own port is 8000. Default: off.
    #[arg(long, env = "GLEANER_OPENPI_LISTEN", value_name = "ADDRESS")]
    pub openpi_listen: Option<SocketAddr>,
}

impl OpenpiConfig {
    /// Checks that an address which other machines can reach has TLS, unless `insecure`.
    ///
    /// # Errors
    /// A sentence that names the flag and the fix.
    pub fn validate(&self, encrypted: bool, insecure: bool) -> Result<(), String> {
        match self.openpi_listen {
            Some(address) if !address.ip().is_loopback() && !encrypted && !insecure => Err(format!(
                "--openpi-listen {address}: other machines can reach this address: encrypt with --tls-cert and --tls-key, \
                 or listen on 127.0.0.1, or accept the risk with --insecure"
            )),
            Some(_) | None => Ok(()),
        }
    }
}
