//! The address of a policy's server, as an operator wrote it.

use gleaner_core::{Error, Result, remote::Protocol};
use http::Uri;

const FIELD: &str = "remote.address";

/// A parsed address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Address {
    /// As it was written.
    pub(crate) text: String,
    pub(crate) encrypted: bool,
    /// A name or an IP address, without brackets.
    pub(crate) host: String,
    pub(crate) port: u16,
}

impl Address {
    /// Reads an address of this protocol.
    ///
    /// # Errors
    /// Invalid with the form of addresses.
    pub(crate) fn parse(protocol: Protocol, text: &str) -> Result<Self> {
        let (plain, encrypted, example) = match protocol {
            Protocol::OpenInference => ("http", "https", "http://gpu:8001 or https://gpu:8001"),
            Protocol::Openpi => ("ws", "wss", "ws://gpu:8000 or wss://gpu:8000/pick_cube"),
        };
        let wrong = |problem: &str| Error::invalid(FIELD, format!("{problem}; write {example}"));
        let uri: Uri = text.parse().map_err(|_| wrong("is not a URL"))?;
        let (Some(scheme), Some(authority)) = (uri.scheme_str(), uri.authority()) else {
            return Err(wrong("must begin with a scheme and a host"));
        };
        let encrypted = match scheme {
            scheme if scheme == plain => false,
            scheme if scheme == encrypted => true,
            _ => return Err(wrong(&format!("does not begin with {plain}:// or {encrypted}://"))),
        };
        if authority.as_str().contains('@') || uri.query().is_some() {
            let fix = "must hold neither credentials nor a query: a token belongs into the file of \
                       --policy-server-tokens";
            return Err(wrong(fix));
        }
        if protocol == Protocol::OpenInference && !matches!(uri.path(), "" | "/") {
            return Err(wrong("must have no path"));
        }
        let Some(port) = uri.port_u16() else { return Err(wrong("must name a port")) };
        let host = authority.host().trim_matches(['[', ']']).to_ascii_lowercase();
        if host.is_empty() || port == 0 {
            return Err(wrong("must name a host and a port"));
        }
        Ok(Self { text: text.to_owned(), encrypted, host, port })
    }

    /// Whether the server is on this machine.
    pub(crate) fn is_loopback(&self) -> bool {
        self.host == "localhost" || self.host.parse::<std::net::IpAddr>().is_ok_and(|address| address.is_loopback())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_of_both_protocols_are_read() {
        let parsed = |protocol, text: &str| {
            let Address { encrypted, host, port, .. } = Address::parse(protocol, text).unwrap();
            (encrypted, host, port)
        };
        assert_eq!(parsed(Protocol::OpenInference, "http://GPU:8001"), (false, "gpu".to_owned(), 8001));
        assert_eq!(parsed(Protocol::OpenInference, "https://10.0.0.5:443/"), (true, "10.0.0.5".to_owned(), 443));
        assert_eq!(parsed(Protocol::Openpi, "ws://[::1]:8000/arm@prod"), (false, "::1".to_owned(), 8000));
        assert!(Address::parse(Protocol::Openpi, "wss://[::1]:8000").unwrap().is_loopback());
        assert!(!Address::parse(Protocol::Openpi, "wss://gpu:8000").unwrap().is_loopback());
    }

    #[test]
    fn other_addresses_are_rejected_with_the_form() {
        for (protocol, text) in [
            (Protocol::OpenInference, ""),
            (Protocol::OpenInference, "gpu:8001"),
            (Protocol::OpenInference, "ws://gpu:8001"),
            (Protocol::OpenInference, "http://gpu"),
            (Protocol::OpenInference, "http://gpu:0"),
            (Protocol::OpenInference, "http://gpu:8001/v2"),
            (Protocol::OpenInference, "http://me:secret@gpu:8001"),
            (Protocol::OpenInference, "file:///etc/passwd"),
            (Protocol::Openpi, "http://gpu:8000"),
            (Protocol::Openpi, "ws://gpu:8000/?token=x"),
            (Protocol::Openpi, "ws://:8000"),
        ] {
            let error = Address::parse(protocol, text).unwrap_err();
            assert!(error.message().starts_with("remote.address: "), "{text}: {error}");
            assert!(error.message().contains("gpu:80") && !error.message().contains("secret"), "{error}");
        }
    }
}
