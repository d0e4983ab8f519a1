//! The warnings about certificates.

use rcgen::{BasicConstraints, CertificateParams, IsCa, KeyPair, PKCS_ED25519, date_time_ymd};

use super::*;

fn parsed(change: impl FnOnce(&mut CertificateParams), key: &KeyPair) -> Parsed {
    let mut params = CertificateParams::new(vec!["lab".to_owned(), "10.0.0.7".to_owned()]).unwrap();
    (params.not_before, params.not_after) = (date_time_ymd(2026, 1, 1), date_time_ymd(2027, 1, 1));
    change(&mut params);
    Parsed::der(params.self_signed(key).unwrap().der()).unwrap()
}

fn at(day: &str) -> Timestamp {
    format!("{day}T12:00:00Z").parse().unwrap()
}

#[test]
fn a_good_certificate_is_not_warned_about_and_names_its_hosts() {
    let good = parsed(|_| (), &KeyPair::generate().unwrap());
    assert_eq!(good.names, ["lab", "10.0.0.7"]);
    assert!(good.warnings(at("2026-06-01")).is_empty());
}

#[test]
fn certificates_that_clients_refuse_now_or_soon_are_warned_about_with_the_fix() {
    let key = KeyPair::generate().unwrap();
    let ed25519 = KeyPair::generate_for(&PKCS_ED25519).unwrap();
    let good = || parsed(|_| (), &key);
    let authority = parsed(|params| params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained), &key);
    let nameless = parsed(|params| params.subject_alt_names.clear(), &key);
    for (certificate, day, part) in [
        (good(), "2027-01-02", "expired on 2027-01-01"),
        (good(), "2025-12-30", "not valid before 2026-01-01"),
        (good(), "2026-12-20", "expires on 2027-01-01"),
        (authority, "2026-06-01", "certificate of an authority"),
        (parsed(|_| (), &ed25519), "2026-06-01", "Ed25519"),
        (nameless, "2026-06-01", "names no host"),
    ] {
        let warnings = certificate.warnings(at(day));
        assert!(
            warnings.len() == 1 && warnings[0].contains(part) && (warnings[0].contains('`') || part.contains("before")),
            "{warnings:?}"
        );
    }
}

#[test]
fn a_file_without_a_certificate_is_named() {
    assert!(Parsed::pem(b"nothing").unwrap_err().contains("no certificate"));
    assert!(Parsed::der(b"nothing").unwrap_err().contains("not an X.509 certificate"));
}
