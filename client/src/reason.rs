//! Why a connection failed, in words that name the fix.
//!
//! The transport's own message is "transport error"; the cause is at the bottom of its chain, and only as text, because
//! the TLS library is the transport's own affair.

use std::error::Error;

/// A part of a cause, and what to do about it. The first that matches counts.
const FIXES: [(&str, &str); 10] = [
    (
        "UnknownIssuer",
        "name the authority that signed the server's certificate with --ca FILE (ca.pem of `gleaner-server tls init`)",
    ),
    (
        "CaUsedAsEndEntity",
        "the server's certificate is that of an authority; make one there with `gleaner-server tls init`",
    ),
    ("certificate expired", "renew it on the server with `gleaner-server tls renew`, and check this machine's clock"),
    ("certificate not valid yet", "check the clocks of both machines"),
    (
        "not valid for name",
        "connect by a name it has, or add this one on the server with `gleaner-server tls renew --name HOST`",
    ),
    ("invalid peer certificate", "make one on the server with `gleaner-server tls init`"),
    (
        "CertificateRequired",
        "the server asks for a certificate of the client's own: give --client-cert and --client-key (made there with \
         `gleaner-server tls client NAME`)",
    ),
    ("fatal alert: UnknownCA", "the server's --client-ca has not signed the certificate given with --client-cert"),
    ("NoApplicationProtocol", "this server does not speak gRPC; use the address of --listen, not that of the pages"),
    // What a client that encrypts gets from a server that does not.
    ("InvalidContentType", "this server does not use TLS; use http://, or start it with --tls-cert and --tls-key"),
];

/// The cause of an error and, where it is known, what to do about it.
pub(crate) fn reason(error: &(dyn Error + 'static)) -> String {
    let cause = cause(error);
    match fix(&cause) {
        Some(fix) => format!("{cause}: {fix}"),
        None => cause,
    }
}

/// Whether a retry is useless, because the cause lasts until a configuration changes.
pub(crate) fn is_lasting(error: &(dyn Error + 'static)) -> bool {
    fix(&cause(error)).is_some()
}

fn cause(error: &(dyn Error + 'static)) -> String {
    let mut cause = error;
    while let Some(next) = cause.source() {
        cause = next;
    }
    cause.to_string()
}

fn fix(cause: &str) -> Option<&'static str> {
    FIXES.iter().find(|(part, _)| cause.contains(part)).map(|(_, fix)| *fix)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("transport error")]
    struct Transport(#[source] std::io::Error);

    #[test]
    fn the_cause_at_the_bottom_is_named_with_its_fix() {
        let error = Transport(std::io::Error::other("invalid peer certificate: UnknownIssuer"));
        assert!(reason(&error).starts_with("invalid peer certificate: UnknownIssuer: name the authority"));
        assert!(is_lasting(&error));
    }

    #[test]
    fn an_unknown_cause_is_shown_alone_and_may_be_retried() {
        let error = Transport(std::io::Error::other("connection reset"));
        assert_eq!(reason(&error), "connection reset");
        assert!(!is_lasting(&error));
    }
}
