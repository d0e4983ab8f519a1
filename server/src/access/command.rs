//! The commands `gleaner-server token …` and `audit`, beside a running server or without one.

use std::io::Write;

use gleaner_recording::printable;
use jiff::{Timestamp, civil, tz::TimeZone};

use super::{
    issue::{IssuedToken, issue},
    span::span,
};
use crate::{
    blobs::Blobs,
    config::{AuditConfig, NewTokenConfig, TokenCommand, TokenConfig},
    data_folder,
    domain::{
        access::{AuditEntry, Token},
        time::Millis,
    },
    error::{Error, Result},
    lock::DataLock,
    store::{Database, Store},
};

/// Creates, lists or revokes tokens.
///
/// # Errors
/// Invalid naming a flag; NotFound; Exists; Precondition when the data folder cannot be used.
pub async fn token(config: TokenConfig, out: &mut impl Write) -> Result<()> {
    let TokenConfig { data_dir, database, command } = config;
    let database = Database::configured(&data_dir, &database)?;
    match command {
        TokenCommand::Create(new) => create(&open(&database, true).await?, new, out).await,
        TokenCommand::List => list(&open(&database, false).await?, out).await,
        TokenCommand::Revoke { token } => revoke(&open(&database, false).await?, &token, out).await,
    }
}

/// Prints the audit log: the callers and their changes.
///
/// # Errors
/// Invalid for a malformed time; Precondition when the data folder cannot be used.
pub async fn audit(config: AuditConfig, out: &mut impl Write) -> Result<()> {
    let since = since(&config.since, Millis::now()).map_err(|problem| Error::invalid("--since", problem))?;
    let store = open(&Database::configured(&config.data_dir, &config.database)?, false).await?;
    for entry in store.audit(since, config.limit).await? {
        let AuditEntry { at, token_id, caller, peer, rpc, subjects, outcome } = entry;
        let id = token_id.map_or_else(|| "-".to_owned(), |id| id.to_string());
        let peer = if peer.is_empty() { "-" } else { &peer };
        let (subjects, peer) = (subjects.join(" "), printable::field(peer));
        let (caller, subjects, outcome) =
            (printable::field(&caller), printable::field(&subjects), printable::field(&outcome));
        writeln!(out, "{}\t{caller}\t{id}\t{peer}\t{rpc}\t{outcome}\t{subjects}", shown(at)).map_err(output_error)?;
    }
    store.close().await;
    Ok(())
}

async fn create(store: &Store, new: NewTokenConfig, out: &mut impl Write) -> Result<()> {
    let IssuedToken { secret, hash, token } = issue(new)?;
    store.insert_token(&token, &hash).await?;
    note(store, "token create", &token).await?;
    writeln!(out, "{}", secret.reveal()).map_err(output_error)?;
    tracing::info!(token.id = %token.id, token.role = token.role.as_str(), "token created; it is printed only once");
    store.close().await;
    Ok(())
}

async fn list(store: &Store, out: &mut impl Write) -> Result<()> {
    let (now, tokens) = (Millis::now(), store.tokens().await?);
    let time = |at: Option<Millis>| at.map_or_else(|| "never".to_owned(), shown);
    let mut line = |cells: [&str; 7]| {
        let [id, role, standing, used, expires, name, deployments] = cells;
        let line = format!("{id:<30}  {role:<11}  {standing:<7}  {used:<20}  {expires:<20}  {name}  {deployments}");
        writeln!(out, "{}", line.trim_end()).map_err(output_error)
    };
    line(["ID", "ROLE", "NOW", "LAST USED", "EXPIRES", "NAME", "DEPLOYMENTS"])?;
    for (_, token) in tokens {
        let Token { id, name, role, deployments, expires_at, last_used_at, .. } = &token;
        let (used, expires, deployments) = (time(*last_used_at), time(*expires_at), deployments.join(","));
        let (name, deployments) = (printable::field(name), printable::field(&deployments));
        line([id.as_str(), role.as_str(), token.standing(now), &used, &expires, &name, &deployments])?;
    }
    store.close().await;
    Ok(())
}

async fn revoke(store: &Store, id_or_name: &str, out: &mut impl Write) -> Result<()> {
    let token = store.revoke_token(id_or_name).await?;
    note(store, "token revoke", &token).await?;
    writeln!(out, "{} is revoked", token.id).map_err(output_error)?;
    store.close().await;
    Ok(())
}

/// Writes a command to the audit log.
async fn note(store: &Store, command: &str, token: &Token) -> Result<()> {
    let subjects = [format!("token_id={}", token.id), format!("role={}", token.role.as_str())];
    let name = (!token.name.is_empty()).then(|| format!("name={}", token.name.escape_debug()));
    let deployments = token.deployments.iter().map(|name| format!("deployment={name}"));
    store
        .insert_audit(&AuditEntry {
            at: Millis::now(),
            token_id: None,
            caller: "command line".to_owned(),
            peer: String::new(),
            rpc: command.to_owned(),
            subjects: subjects.into_iter().chain(name).chain(deployments).collect(),
            outcome: "ok".to_owned(),
        })
        .await
}

/// Opens the database of a data folder. Beside a running server it is opened as it is; without one it is migrated, and
/// created if `create` is set.
async fn open(database: &Database, create: bool) -> Result<Store> {
    let data_dir = database.data_dir.as_path();
    let path = data_folder::database(data_dir);
    if database.postgres.is_none() && !create && !path.is_file() {
        let folder = data_dir.display();
        return Err(Error::precondition(format!(
            "{folder} holds no database; --data-dir names a server's data folder"
        )));
    }
    match (DataLock::take(data_dir), &database.postgres) {
        (Ok(_alone), _) => Store::open_with_blobs(database, &Blobs::open(data_dir)?, false).await,
        (Err(_), None) => Store::open_shared(&path).await,
        (Err(_), Some(at)) => Store::open_beside(at).await,
    }
}

fn since(text: &str, now: Millis) -> std::result::Result<Millis, String> {
    if let Ok(time) = text.parse::<Timestamp>() {
        return Ok(Millis(time.as_millisecond()));
    }
    if let Ok(day) = text.parse::<civil::Date>()
        && let Ok(begins) = day.to_zoned(TimeZone::system())
    {
        return Ok(Millis(begins.timestamp().as_millisecond()));
    }
    let ago = span(text).map_err(|problem| format!("{problem}, a day such as 2026-11-20, or a time with its zone"))?;
    Ok(Millis(now.0.saturating_sub(i64::try_from(ago.as_millis()).unwrap_or(i64::MAX))))
}

fn shown(at: Millis) -> String {
    Timestamp::from_millisecond(at.0).map_or_else(|_| at.0.to_string(), |time| format!("{time:.0}"))
}

fn output_error(error: std::io::Error) -> Error {
    Error::internal("writing the output", error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    use crate::{config::DatabaseConfig, domain::access::Role, error::Kind};

    #[test]
    fn times_are_parsed_in_each_format() {
        let now = Millis(10_000_000);
        assert_eq!(since("1h", now).unwrap(), Millis(6_400_000));
        assert_eq!(since("1970-01-01T00:00:05Z", now).unwrap(), Millis(5000));
        assert!(since("2026-11-20", now).unwrap() > now);
        assert!(since("yesterday", now).unwrap_err().contains("2026-11-20"));
    }

    async fn run(data_dir: &Path, command: TokenCommand) -> Result<String> {
        let mut out = Vec::new();
        token(TokenConfig { data_dir: data_dir.to_owned(), database: DatabaseConfig::default(), command }, &mut out)
            .await?;
        Ok(String::from_utf8(out).unwrap())
    }

    fn new(name: &str) -> TokenCommand {
        let (deployments, expires) = (vec!["arm@prod".to_owned()], Some("30d".to_owned()));
        TokenCommand::Create(NewTokenConfig { role: Role::Robot, name: name.to_owned(), deployments, expires })
    }

    #[tokio::test]
    async fn a_token_is_created_listed_and_revoked_and_printed_only_once() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("lab");
        assert_eq!(run(&folder, TokenCommand::List).await.unwrap_err().kind(), Kind::Precondition);
        let made = run(&folder, new("arm")).await.unwrap();
        let secret = made.trim();
        assert!(secret.starts_with("gleaner_") && made.lines().count() == 1);

        let listed = run(&folder, TokenCommand::List).await.unwrap();
        for word in ["arm", "robot", "arm@prod", "live", "never"] {
            assert!(listed.contains(word), "{word}: {listed}");
        }
        let revoked = run(&folder, TokenCommand::Revoke { token: "arm".into() }).await.unwrap();
        assert!(revoked.contains("is revoked"));
        assert!(run(&folder, TokenCommand::List).await.unwrap().contains("revoked"));
        assert_eq!(
            run(&folder, TokenCommand::Revoke { token: "arm".into() }).await.unwrap_err().kind(),
            Kind::NotFound
        );

        let mut log = Vec::new();
        let database = DatabaseConfig::default();
        let config = AuditConfig { data_dir: folder.clone(), since: "1h".into(), limit: 10, database };
        audit(config, &mut log).await.unwrap();
        let log = String::from_utf8(log).unwrap();
        assert!(log.contains("token create") && log.contains("token revoke") && log.contains("command line"), "{log}");
        let database = std::fs::read(folder.join("gleaner.db")).unwrap();
        let leaks = |bytes: &[u8]| bytes.windows(secret.len()).any(|part| part == secret.as_bytes());
        assert!(!leaks(listed.as_bytes()) && !leaks(log.as_bytes()) && !leaks(&database));
    }

    #[tokio::test]
    async fn tokens_are_created_beside_a_running_server() {
        let dir = tempfile::tempdir().unwrap();
        let _server = DataLock::take(dir.path()).unwrap();
        let store = Store::open(&dir.path().join("gleaner.db")).await.unwrap();
        run(dir.path(), new("arm")).await.unwrap();
        assert_eq!(store.tokens().await.unwrap()[0].1.name, "arm");
        let again = run(dir.path(), new("arm")).await.unwrap_err();
        assert_eq!(again.kind(), Kind::Exists);
    }
}
