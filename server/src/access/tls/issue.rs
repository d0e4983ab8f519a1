//! Certificates that every client of ours accepts: ECDSA P-256, a small authority, servers and clients signed by it.
//!
//! P-256 because the TLS of grpcio does not verify Ed25519. An authority of its own, because a certificate that is both
//! authority and server is refused by the TLS of the command line (RFC 5280: an end entity is no authority).

use std::{
    net::IpAddr,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, PKCS_ECDSA_P256_SHA256, PublicKeyData as _, SanType,
};

use super::parsed::Parsed;
use crate::error::{Error, Result};

const DAY: u64 = 24 * 60 * 60;
/// Validity of an authority. With a longer one, clients need a new ca.pem less often.
const AUTHORITY_DAYS: u64 = 3650;
/// Clocks of robots may be behind by this much.
const CLOCK_SKEW: u64 = DAY;

/// A certificate and its private key, both as PEM.
pub(super) struct Issued {
    pub(super) cert: String,
    pub(super) key: String,
    /// End of its validity, in seconds since 1970.
    pub(super) expires: u64,
}

/// An authority that can sign.
pub(super) struct Authority {
    issuer: Issuer<'static, KeyPair>,
    expires: u64,
}

impl Authority {
    /// Makes an authority; also its certificate and key, to be kept.
    ///
    /// # Errors
    /// Internal when no key can be made.
    pub(super) fn new(now: SystemTime) -> Result<(Self, Issued)> {
        let key = new_key()?;
        let expires = seconds(now) + AUTHORITY_DAYS * DAY;
        let mut params = params(now, expires);
        // A name of its own, so that two authorities in one file of certificates are not mistaken for each other.
        let suffix: String = key.public_key_raw().iter().rev().take(4).map(|byte| format!("{byte:02x}")).collect();
        params.distinguished_name = named(&format!("gleaner authority {suffix}"));
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        let cert = params.self_signed(&key).map_err(failed)?.pem();
        let issued = Issued { cert, key: key.serialize_pem(), expires };
        Ok((Self { issuer: Issuer::new(params, key), expires }, issued))
    }

    /// An existing authority, from its certificate and key.
    ///
    /// # Errors
    /// A sentence when they cannot be read, do not belong together, or have expired.
    pub(super) fn read(cert: &str, key: &str, now: SystemTime) -> std::result::Result<Self, String> {
        let parsed = Parsed::pem(cert.as_bytes())?;
        let key = KeyPair::from_pem(key).map_err(|error| format!("the key cannot be read: {error}"))?;
        if !parsed.is_authority {
            return Err("the certificate is not that of an authority".to_owned());
        }
        if parsed.public_key != key.subject_public_key_info() {
            return Err("the certificate and the key do not belong together".to_owned());
        }
        let expires = u64::try_from(parsed.not_after).unwrap_or(0);
        if expires <= seconds(now) {
            return Err(
                "the authority has expired; make a new one with `gleaner-server tls init --overwrite`".to_owned()
            );
        }
        let issuer = Issuer::from_ca_cert_pem(cert, key).map_err(|error| error.to_string())?;
        Ok(Self { issuer, expires })
    }

    /// Signs a certificate for a server with these names.
    ///
    /// # Errors
    /// Internal when no key can be made.
    pub(super) fn server(&self, names: &[SanType], days: u32, now: SystemTime) -> Result<Issued> {
        let mut params = self.end_entity("gleaner server", days, now);
        params.subject_alt_names = names.to_vec();
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
        self.sign(&params, days, now)
    }

    /// Signs a certificate for a client.
    ///
    /// # Errors
    /// Internal when no key can be made.
    pub(super) fn client(&self, name: &str, days: u32, now: SystemTime) -> Result<Issued> {
        let mut params = self.end_entity(name, days, now);
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
        self.sign(&params, days, now)
    }

    fn end_entity(&self, name: &str, days: u32, now: SystemTime) -> CertificateParams {
        let mut params = params(now, self.expiry(days, now));
        params.distinguished_name = named(name);
        params.is_ca = IsCa::ExplicitNoCa;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.use_authority_key_identifier_extension = true;
        params
    }

    fn sign(&self, params: &CertificateParams, days: u32, now: SystemTime) -> Result<Issued> {
        let key = new_key()?;
        let cert = params.signed_by(&key, &self.issuer).map_err(failed)?.pem();
        Ok(Issued { cert, key: key.serialize_pem(), expires: self.expiry(days, now) })
    }

    /// No certificate outlives its authority.
    fn expiry(&self, days: u32, now: SystemTime) -> u64 {
        self.expires.min(seconds(now) + u64::from(days) * DAY)
    }
}

/// A host name or an IP address as a certificate names it.
///
/// # Errors
/// A sentence when it is neither.
pub(super) fn server_name(text: &str) -> std::result::Result<SanType, String> {
    if let Ok(address) = text.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>() {
        return Ok(SanType::IpAddress(address));
    }
    let host = text.trim_end_matches('.').to_ascii_lowercase();
    let label = |label: &str| {
        (1..=63).contains(&label.len())
            && !label.starts_with('-')
            && !label.ends_with('-')
            && label.bytes().all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_'))
    };
    if host.len() > 253 || !host.strip_prefix("*.").unwrap_or(&host).split('.').all(label) {
        return Err(format!(
            "{text:?} is neither a host name nor an IP address; write it as in the server's address, without https:// \
             and port (names with other letters in their xn-- form)"
        ));
    }
    host.try_into().map(SanType::DnsName).map_err(|error: rcgen::Error| error.to_string())
}

fn params(now: SystemTime, expires: u64) -> CertificateParams {
    let at = |seconds: u64| rcgen::date_time_ymd(1970, 1, 1) + Duration::from_secs(seconds);
    let mut params = CertificateParams::default();
    params.not_before = at(seconds(now).saturating_sub(CLOCK_SKEW));
    params.not_after = at(expires);
    params
}

fn named(name: &str) -> DistinguishedName {
    let mut names = DistinguishedName::new();
    names.push(DnType::CommonName, name);
    names
}

fn new_key() -> Result<KeyPair> {
    KeyPair::generate_for(&PKCS_ECDSA_P256_SHA256).map_err(failed)
}

fn failed(error: rcgen::Error) -> Error {
    Error::internal("making a certificate", error)
}

fn seconds(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs()
}
