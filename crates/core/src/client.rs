//! The identity that calls, inspections and open uploads are counted for.

use std::{fmt, net::IpAddr, sync::Arc};

use super::id::TokenId;

/// The identity that calls, inspections and open uploads are counted for.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Client {
    /// The holder of a token, by the token's id.
    Token(Arc<str>),
    /// A peer without a token, by its IPv4 address or IPv6 /64.
    Address(IpAddr),
    /// The server itself: recordings of sessions, rebuilt frame caches.
    Server,
}

impl Client {
    /// The holder of the token with this id.
    pub fn token(id: &TokenId) -> Self {
        Self::Token(id.as_str().into())
    }

    /// Reads the text stored in rows, which [`fmt::Display`] writes.
    pub fn parse(text: &str) -> Option<Self> {
        match text.split_once(':') {
            Some(("token", id)) => Some(Self::Token(id.into())),
            Some(("address", address)) => address.parse().ok().map(Self::Address),
            Some(_) => None,
            None => (text == SERVER).then_some(Self::Server),
        }
    }
}

const SERVER: &str = "server";

impl fmt::Display for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Token(id) => write!(f, "token:{id}"),
            Self::Address(address) => write!(f, "address:{address}"),
            Self::Server => f.write_str(SERVER),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, Ipv6Addr};

    use super::*;

    #[test]
    fn text_of_a_client_parses_to_the_same_client() {
        for client in [
            Client::Token("tok_1".into()),
            Client::Address(Ipv4Addr::LOCALHOST.into()),
            Client::Address(Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, 0).into()),
            Client::Server,
        ] {
            assert_eq!(Client::parse(&client.to_string()), Some(client));
        }
        for text in ["", "token", "address:here", "robot:1"] {
            assert_eq!(Client::parse(text), None, "{text:?}");
        }
    }
}
