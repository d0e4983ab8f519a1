//! The content of a certificate, and its properties that prevent clients from connecting.

use std::net::IpAddr;

use jiff::Timestamp;
use x509_parser::{
    extensions::GeneralName,
    oid_registry::OID_SIG_ED25519,
    pem::parse_x509_pem,
    prelude::{FromDer as _, X509Certificate},
};

/// Time before the end of a certificate from which it causes a warning, in seconds.
const SOON: i64 = 30 * 24 * 60 * 60;

/// The parts of a certificate that this server uses.
#[derive(Debug, Clone)]
pub(super) struct Parsed {
    /// Seconds since 1970.
    pub(super) not_before: i64,
    /// Seconds since 1970.
    pub(super) not_after: i64,
    pub(super) is_authority: bool,
    is_ed25519: bool,
    /// Host names and addresses that it is for.
    pub(super) names: Vec<String>,
    /// The public key with its algorithm, as DER.
    pub(super) public_key: Vec<u8>,
}

impl Parsed {
    /// Reads the first certificate of a PEM file.
    ///
    /// # Errors
    /// A sentence if the file has no certificate.
    pub(super) fn pem(pem: &[u8]) -> Result<Self, String> {
        let (_, block) = parse_x509_pem(pem).map_err(|error| format!("holds no certificate in PEM form: {error}"))?;
        Self::der(&block.contents)
    }

    /// Reads a certificate.
    ///
    /// # Errors
    /// A sentence when it is not one.
    pub(super) fn der(der: &[u8]) -> Result<Self, String> {
        let (_, certificate) =
            X509Certificate::from_der(der).map_err(|error| format!("is not an X.509 certificate: {error}"))?;
        let names = certificate
            .subject_alternative_name()
            .ok()
            .flatten()
            .map_or_else(Vec::new, |names| names.value.general_names.iter().filter_map(shown).collect());
        Ok(Self {
            not_before: certificate.validity().not_before.timestamp(),
            not_after: certificate.validity().not_after.timestamp(),
            is_authority: certificate.is_ca(),
            is_ed25519: certificate.public_key().algorithm.algorithm == OID_SIG_ED25519,
            names,
            public_key: certificate.public_key().raw.to_vec(),
        })
    }

    /// Why clients will refuse a server with this certificate now or soon, each with the fix.
    pub(super) fn warnings(&self, now: Timestamp) -> Vec<String> {
        let now = now.as_second();
        let renew = "renew it with `gleaner-server tls renew`, or with the tool that issued it";
        let mut warnings = Vec::new();
        if self.not_after < now {
            warnings.push(format!("it expired on {} and clients refuse it; {renew}", day(self.not_after)));
        } else if self.not_before > now {
            warnings.push(format!(
                "it is not valid before {} and clients refuse it until then; check this machine's clock",
                day(self.not_before)
            ));
        } else if self.not_after < now + SOON {
            warnings.push(format!("it expires on {}; {renew}", day(self.not_after)));
        }
        let make = "make one with `gleaner-server tls init`";
        if self.is_authority {
            warnings.push(format!("it is the certificate of an authority, which the gleaner command refuses; {make}"));
        }
        if self.is_ed25519 {
            warnings.push(format!("its key is Ed25519, which Python clients (grpcio) cannot verify; {make}"));
        }
        if self.names.is_empty() {
            warnings.push(format!("it names no host (subjectAltName), so clients refuse it; {make}"));
        }
        warnings
    }
}

/// A day in UTC, such as 2026-11-22.
pub(super) fn day(seconds: i64) -> String {
    Timestamp::from_second(seconds).map(|at| at.strftime("%Y-%m-%d").to_string()).unwrap_or_default()
}

fn shown(name: &GeneralName<'_>) -> Option<String> {
    if let GeneralName::DNSName(host) = name {
        return Some((*host).to_owned());
    }
    let GeneralName::IPAddress(bytes) = name else { return None };
    let v4 = <[u8; 4]>::try_from(*bytes).map(IpAddr::from);
    let v6 = <[u8; 16]>::try_from(*bytes).map(IpAddr::from);
    v4.or(v6).ok().map(|address| address.to_string())
}

#[cfg(test)]
mod tests;
