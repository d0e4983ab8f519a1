//! `gleaner-server tls …`: a private authority and its certificates, created beside a running server or without one.

use std::{io::Write, path::Path, time::SystemTime};

use rcgen::SanType;

use super::{
    folder::{Folder, Owner},
    issue::{Authority, Issued, server_name},
    parsed::{Parsed, day},
};
use crate::{
    config::{TlsClientConfig, TlsCommand, TlsConfig, TlsFolderConfig, TlsServerConfig},
    error::{Error, Result},
};

/// Names that every server certificate has.
const LOOPBACK: [&str; 3] = ["localhost", "127.0.0.1", "::1"];
/// Longest name of a client, in characters: X.509 allows 64 for a common name.
const LONGEST_CLIENT: usize = 64;

/// Creates or renews certificates and writes instructions for their use to `out`.
///
/// # Errors
/// Invalid naming a flag; Exists when a file would be replaced; Precondition when the authority cannot be used; Internal
/// when the disk rejects a write.
pub fn run(config: &TlsConfig, out: &mut impl Write) -> Result<()> {
    match &config.command {
        TlsCommand::Init { server, overwrite } => init(server, *overwrite, out),
        TlsCommand::Renew(server) => renew(server, out),
        TlsCommand::Client(client) => self::client(client, out),
    }
}

fn init(config: &TlsServerConfig, overwrite: bool, out: &mut impl Write) -> Result<()> {
    let folder = Folder::at(config.folder.path());
    let existing = folder.existing(Owner::Authority).or_else(|| folder.existing(Owner::Server));
    if let Some(path) = existing.filter(|_| !overwrite) {
        return Err(Error::exists(format!(
            "{} exists already; make a new server certificate with `gleaner-server tls renew`, or replace the authority \
             too with --overwrite (every client then needs the new ca.pem)",
            path.display()
        )));
    }
    let given = if config.names.is_empty() { host_name().into_iter().collect() } else { config.names.clone() };
    let (names, now) = (Names::with_loopback(&given)?, SystemTime::now());
    let (authority, kept) = Authority::new(now)?;
    let issued = authority.server(&names.alternatives, config.days, now)?;
    folder.create()?;
    folder.write(Owner::Authority, &kept, overwrite)?;
    folder.write(Owner::Server, &issued, overwrite)?;
    let (ca, ca_key) = (folder.cert(Owner::Authority), folder.key(Owner::Authority));
    let (cert, key) = (folder.cert(Owner::Server), folder.key(Owner::Server));
    let until = until(&issued);
    write(
        out,
        format_args!(
            "made an authority and a server certificate for {shown}, valid until {until}\n\n\
             start the server:\n  \
             gleaner-server serve --data-dir {data} --listen 0.0.0.0:7400 --tls-cert {cert} --tls-key {key}\n\
             copy {ca} to every client (it is not secret) and name it there:\n  \
             export GLEANER_SERVER=https://{host}:7400 GLEANER_CA=ca.pem\n\
             keep {ca_key} secret: it can sign certificates that your clients trust; only `tls renew` and `tls client` \
             need it",
            shown = names.shown.join(", "),
            host = names.for_address(),
            data = quoted(&config.folder.data_dir),
            cert = quoted(&cert),
            key = quoted(&key),
            ca = quoted(&ca),
            ca_key = quoted(&ca_key),
        ),
    )
}

fn renew(config: &TlsServerConfig, out: &mut impl Write) -> Result<()> {
    let folder = Folder::at(config.folder.path());
    let (now, cert) = (SystemTime::now(), folder.cert(Owner::Server));
    let authority = authority(&folder, now)?;
    let given = if config.names.is_empty() {
        let unusable =
            |problem| Error::precondition(format!("{}: {problem}; give the names with --name", cert.display()));
        Parsed::pem(folder.read(&cert)?.as_bytes()).map_err(unusable)?.names
    } else {
        config.names.clone()
    };
    let names = Names::with_loopback(&given)?;
    let issued = authority.server(&names.alternatives, config.days, now)?;
    folder.write(Owner::Server, &issued, true)?;
    let (shown, until) = (names.shown.join(", "), until(&issued));
    write(
        out,
        format_args!(
            "made a new server certificate {} for {shown}, valid until {until}; a running server reads it within seconds, \
             and clients need nothing new",
            quoted(&cert)
        ),
    )
}

fn client(config: &TlsClientConfig, out: &mut impl Write) -> Result<()> {
    let TlsClientConfig { name, folder, days } = config;
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.' | b'@');
    if name.is_empty() || name.len() > LONGEST_CLIENT || !name.bytes().all(allowed) {
        return Err(Error::invalid(
            "NAME",
            format!("must be 1 to {LONGEST_CLIENT} letters, digits or -_.@, such as arm1"),
        ));
    }
    let folder = self::Folder::at(TlsFolderConfig::path(folder));
    let (owner, now) = (Owner::Client(name), SystemTime::now());
    if let Some(path) = folder.existing(owner) {
        return Err(Error::exists(format!("{} exists already; remove it or choose another name", path.display())));
    }
    let issued = authority(&folder, now)?.client(name, *days, now)?;
    folder.write(owner, &issued, false)?;
    let (cert, key) = (folder.cert(owner), folder.key(owner));
    write(
        out,
        format_args!(
            "made a certificate for the client {name}, valid until {until}; give it {cert} and {key}:\n  export \
             GLEANER_CLIENT_CERT={cert} GLEANER_CLIENT_KEY={key}\nthe server requires it when it runs with --client-ca \
             {ca}",
            until = until(&issued),
            cert = quoted(&cert),
            key = quoted(&key),
            ca = quoted(&folder.cert(Owner::Authority)),
        ),
    )
}

fn authority(folder: &Folder, now: SystemTime) -> Result<Authority> {
    let (cert, key) = (folder.cert(Owner::Authority), folder.key(Owner::Authority));
    Authority::read(&folder.read(&cert)?, &folder.read(&key)?, now)
        .map_err(|problem| Error::precondition(format!("{} and {}: {problem}", cert.display(), key.display())))
}

/// The names of a server certificate, each once.
struct Names {
    alternatives: Vec<SanType>,
    shown: Vec<String>,
}

impl Names {
    fn with_loopback(given: &[String]) -> Result<Self> {
        let mut names = Self { alternatives: Vec::new(), shown: Vec::new() };
        for name in given.iter().map(String::as_str).chain(LOOPBACK) {
            let alternative = server_name(name).map_err(|problem| Error::invalid("--name", problem))?;
            if !names.alternatives.contains(&alternative) {
                names.alternatives.push(alternative);
                names.shown.push(name.to_owned());
            }
        }
        Ok(names)
    }

    /// The first name, in the form of an address.
    fn for_address(&self) -> String {
        match (self.alternatives.first(), self.shown.first()) {
            (Some(SanType::IpAddress(std::net::IpAddr::V6(address))), _) => format!("[{address}]"),
            (_, first) => first.cloned().unwrap_or_default(),
        }
    }
}

/// The host name of this machine, if a certificate can contain it.
fn host_name() -> Option<String> {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").ok()?;
    let name = name.trim();
    server_name(name).ok().map(|_| name.to_owned())
}

/// A path, quoted for a shell.
fn quoted(path: &Path) -> String {
    let path = path.display().to_string();
    let plain =
        |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.' | b'/' | b'@' | b'+' | b',');
    if !path.is_empty() && path.bytes().all(plain) { path } else { format!("'{}'", path.replace('\'', "'\\''")) }
}

fn until(issued: &Issued) -> String {
    day(i64::try_from(issued.expires).unwrap_or(i64::MAX))
}

fn write(out: &mut impl Write, text: std::fmt::Arguments<'_>) -> Result<()> {
    writeln!(out, "{text}").map_err(|error| Error::internal("writing to standard output", error))
}

#[cfg(test)]
mod tests;
