//! TLS to PostgreSQL by `sslmode` and `sslrootcert` of the address.

use std::{fs, path::Path};

use gleaner_test_postgres::Server;
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};

use super::{Postgres, Store, refused, selected};

/// The certificate of an authority, and a certificate for a name with its key, as PEM.
fn issued(name: &str) -> (String, String, String) {
    let mut authority = CertificateParams::default();
    authority.distinguished_name.push(DnType::CommonName, "authority of a test");
    authority.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let key = KeyPair::generate().unwrap();
    let certificate = authority.self_signed(&key).unwrap().pem();
    let issuer = Issuer::new(authority, key);
    let key = KeyPair::generate().unwrap();
    let issued = CertificateParams::new([name.to_owned()]).unwrap().signed_by(&key, &issuer).unwrap();
    (certificate, issued.pem(), key.serialize_pem())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn certificate_of_postgresql_is_checked_against_the_authority_and_the_host() {
    if !selected() {
        return;
    }
    let mut server = Server::start();
    let (host, dir) = (Server::own_address(), tempfile::tempdir().unwrap());
    let (authority, certificate, key) = issued(&host);
    server.serve_tls(&host, &certificate, &key);
    let (right, wrong) = (dir.path().join("right.pem"), dir.path().join("wrong.pem"));
    fs::write(&right, authority).unwrap();
    fs::write(&wrong, issued(&host).0).unwrap();
    let database = server.database();
    let url = |mode: &str, root: &Path| {
        format!("postgres://gleaner@{host}/{database}?sslmode={mode}&sslrootcert={}", root.display())
    };
    let store = Store::serve_postgres(&Postgres::at(&url("verify-full", &right)).unwrap()).await.unwrap();
    let plain = "select count(*) from pg_stat_ssl join pg_stat_activity using (pid) \
                 where application_name like 'gleaner %' and not ssl";
    assert_eq!(server.execute(&database, plain), "0");
    let encrypted = plain.replace("not ssl", "ssl");
    assert_ne!(server.execute(&database, &encrypted), "0");
    store.close().await;

    let error = refused(&url("verify-full", &wrong)).await;
    assert!(error.message().contains("certificate") && error.message().contains("sslrootcert"), "{error}");
    // The certificate of another host, by the right authority.
    let (authority, certificate, key) = issued("db.lab");
    fs::write(&right, authority).unwrap();
    server.serve_tls(&host, &certificate, &key);
    let error = refused(&url("verify-full", &right)).await;
    assert!(error.message().contains("certificate") && error.message().contains("sslrootcert"), "{error}");
    Store::serve_postgres(&Postgres::at(&url("verify-ca", &right)).unwrap()).await.unwrap().close().await;
}
