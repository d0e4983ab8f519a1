//! Other servers that run policies: which of them this server may call, and how.

use std::path::PathBuf;

use clap::Args;
use gleaner_remote::Hosts;

/// Other servers that run policies.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Policies of other servers")]
pub struct PolicyServersConfig {
    /// Hosts to which this server may connect for policies that an admin registers: HOST or HOST:PORT, separated by
    /// commas. Every other address is rejected, this machine's too. Default: none.
    #[arg(long, env = "GLEANER_POLICY_SERVERS", value_delimiter = ',', value_name = "HOST[:PORT]")]
    pub policy_servers: Vec<String>,
    /// File with a line `HOST:PORT TOKEN` for each of these servers that requires a token. It is read for each new
    /// connection. Tokens are sent to these hosts only, over TLS or on this machine. Default: no tokens.
    #[arg(long, env = "GLEANER_POLICY_SERVER_TOKENS", value_name = "FILE", requires = "policy_servers")]
    pub policy_server_tokens: Option<PathBuf>,
    /// Authorities, one of which must have signed the certificates of these servers: a PEM file. Default: the system's.
    #[arg(long, env = "GLEANER_POLICY_SERVER_CA", value_name = "FILE", requires = "policy_servers")]
    pub policy_server_ca: Option<PathBuf>,
}

impl PolicyServersConfig {
    /// Checks the hosts, and that the files can be read.
    ///
    /// # Errors
    /// A sentence that names the flag and the fix.
    pub fn validate(&self) -> Result<(), String> {
        Hosts::parse(&self.policy_servers).map_err(|problem| format!("--policy-servers: {problem}"))?;
        for (flag, path) in
            [("--policy-server-tokens", &self.policy_server_tokens), ("--policy-server-ca", &self.policy_server_ca)]
        {
            let Some(path) = path else { continue };
            std::fs::File::open(path).map_err(|error| format!("{flag} {}: {error}", path.display()))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Alone {
        #[command(flatten)]
        servers: PolicyServersConfig,
    }

    fn with(args: &[&str]) -> Result<(), String> {
        let all = [&["serve"], args].concat();
        Alone::try_parse_from(all).map_err(|error| error.to_string())?.servers.validate()
    }

    #[test]
    fn hosts_and_files_are_checked() {
        assert_eq!(with(&[]), Ok(()));
        assert_eq!(with(&["--policy-servers", "gpu:8001,[::1]:8000,10.0.0.5"]), Ok(()));
        assert!(with(&["--policy-servers", "http://gpu:8001"]).unwrap_err().starts_with("--policy-servers: "));
        assert!(with(&["--policy-server-tokens", "/dev/null"]).unwrap_err().contains("--policy-servers"));
        let absent = ["--policy-servers", "gpu", "--policy-server-ca", "/dev/null/absent"];
        assert!(with(&absent).unwrap_err().starts_with("--policy-server-ca /dev/null/absent: "));
    }
}
