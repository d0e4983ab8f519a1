//! One server has a database in PostgreSQL, and survives the loss of its connections. Run where `GLEANER_TEST_DATABASE`
//! selects PostgreSQL.

mod tls;

use gleaner_test_postgres::{GUARDED_ROLE, PASSWORD, Proxy, Server};

use super::*;
use crate::{
    domain::episode::Outcome,
    error::Kind,
    store::{Database, Store, fault::fault, schema, testing},
};

/// Whether the tests run on PostgreSQL; else prints that one is skipped.
fn selected() -> bool {
    testing::postgres_selected()
}

async fn refused(url: &str) -> Error {
    let error = Store::serve_postgres(&Postgres::at(url).unwrap()).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition, "{error}");
    error
}

#[tokio::test]
async fn second_server_of_a_database_is_refused() {
    if !selected() {
        return;
    }
    let at = testing::postgres().await;
    let first = Store::serve_postgres(&at).await.unwrap();
    let error = Store::serve_postgres(&at).await.unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("another gleaner-server uses"), "{error}");
    assert!(error.message().contains("--database"), "{error}");
    testing::task(&first).await;
    first.close().await;
    let next = Store::serve_postgres(&at).await.unwrap();
    assert_eq!(next.tasks().await.unwrap().len(), 1);
}

#[tokio::test]
async fn commands_write_beside_a_server_one_at_a_time() {
    if !selected() {
        return;
    }
    let at = testing::postgres().await;
    let empty = Store::open_beside(&at).await.unwrap_err();
    assert!(empty.kind() == Kind::Precondition && empty.message().contains("is empty"), "{empty}");
    let server = Store::serve_postgres(&at).await.unwrap();
    let command = Store::open_beside(&at).await.unwrap();
    let count = async |store: &Store| {
        for _ in 0..20 {
            let mut tx = store.write().await.unwrap();
            let read = super::super::row::query_as("select elapsed_ms from lab").fetch_one(&mut tx).await;
            let counted: i64 = read.unwrap();
            let write = super::super::sql::query("update lab set elapsed_ms = $1").bind(counted + 1);
            write.execute(&mut tx).await.unwrap();
            store.commit(tx).await.unwrap();
        }
    };
    tokio::join!(count(&server), count(&command));
    let counted: i64 =
        super::super::row::query_as("select elapsed_ms from lab").fetch_one(server.read()).await.unwrap();
    assert_eq!(counted, 40);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn lost_connections_are_unavailable_until_postgresql_is_back() {
    if !selected() {
        return;
    }
    let mut server = Server::start();
    let at = Postgres::at(&server.url(&server.database())).unwrap();
    let store = Store::serve_postgres(&at).await.unwrap();
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    for kill in [false, true] {
        if kill {
            server.kill()
        } else {
            server.stop()
        }
        let upload = testing::upload(&task, b"lost");
        let (read, written) = tokio::join!(store.tasks(), store.insert_upload(&upload, None));
        for error in [read.map(drop).unwrap_err(), written.map(drop).unwrap_err()] {
            assert!(error.kind() == Kind::Unavailable && error.message().contains("retry"), "{error}");
        }
        server.serve();
        assert_eq!(store.tasks().await.unwrap()[0].1.success, 1);
        assert!(store.insert_upload(&upload, None).await.unwrap());
        store.delete_upload(&upload.id).await.unwrap();
    }
}

/// A cut cable gives no error: no byte arrives any more, and PostgreSQL gets no end of the connection either, so that the
/// one that hangs still holds the lock of the server.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_that_hang_fail_their_calls_in_time_and_are_replaced() {
    if !selected() {
        return;
    }
    let server = gleaner_test_postgres::shared();
    let proxy = Proxy::start(server);
    let timeout = Duration::from_secs(2);
    let at = Postgres { timeout, ..Postgres::at(&proxy.url(&server.database())).unwrap() };
    let store = Store::serve_postgres(&at).await.unwrap();
    let task = testing::task(&store).await;
    let slowest = timeout * 4;
    // Within a transaction, then on the connections of the pools.
    let mut tx = store.write().await.unwrap();
    proxy.cut();
    let statement = super::super::row::query_as("select generation from lab").fetch_one(&mut tx);
    let read: sqlx::Result<i64> = tokio::time::timeout(slowest, statement).await.unwrap();
    let error = fault("waiting")(read.unwrap_err());
    assert!(error.kind() == Kind::Unavailable && error.message().contains("retry"), "{error}");
    drop(tx);
    for _ in 0..2 {
        let upload = testing::upload(&task, b"lost");
        let both = async { tokio::join!(store.tasks(), store.insert_upload(&upload, None)) };
        let (read, written) = tokio::time::timeout(slowest, both).await.unwrap();
        for error in [read.map(drop).unwrap_err(), written.map(drop).unwrap_err()] {
            assert!(error.kind() == Kind::Unavailable && error.message().contains("retry"), "{error}");
        }
    }
    proxy.restore();
    let upload = testing::upload(&task, b"late");
    assert!(store.insert_upload(&upload, None).await.unwrap());
    assert_eq!(store.tasks().await.unwrap().len(), 1);
    assert_eq!(store.uploads().await.unwrap().len(), 1);
}

/// A statement that takes as long as its connection answers is not the same as one without an answer.
#[tokio::test]
async fn rows_may_take_longer_than_the_longest_silence_together() {
    if !selected() {
        return;
    }
    let timeout = Duration::from_secs(2);
    let at = Postgres { timeout, ..testing::postgres().await };
    let store = Store::serve_postgres(&at).await.unwrap();
    // PostgreSQL collects rows until they fill a buffer of 8 KiB.
    let slow = "select repeat('x', 20000) from generate_series(1, 6) where pg_sleep(0.5) is not null";
    let rows: Vec<String> = super::super::row::query_as(slow).fetch_all(store.read()).await.unwrap();
    assert_eq!(rows.len(), 6);
    let silent = super::super::row::query_as("select 'late' where pg_sleep(60) is not null");
    let late: sqlx::Result<Vec<String>> = silent.fetch_all(store.read()).await;
    let error = fault("waiting")(late.unwrap_err());
    assert_eq!(error.kind(), Kind::Unavailable, "{error}");
}

/// What a failover to a replica that lags looks like: another generation behind the same address.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_earlier_copy_that_takes_over_ends_the_writes() {
    if !selected() {
        return;
    }
    let server = gleaner_test_postgres::shared();
    let (name, dir) = (server.database(), tempfile::tempdir().unwrap());
    let at = Postgres::at(&server.url(&name)).unwrap();
    let database = Database { data_dir: dir.path().to_owned(), postgres: Some(at) };
    let blobs = crate::blobs::Blobs::open(dir.path()).unwrap();
    let store = Store::open_with_blobs(&database, &blobs, false).await.unwrap();
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    let lose = |statement: &str| {
        server.execute(&name, statement);
        let others = "select pg_terminate_backend(pid) from pg_stat_activity where datname = current_database() and \
                      pid <> pg_backend_pid()";
        server.execute(&name, others);
    };
    lose("select 1");
    testing::episode(&store, &task, Outcome::Success, "").await;
    assert!(!store.lost().is_cancelled(), "the same database");

    lose("update lab set generation = generation - 1");
    let error = store.insert_upload(&testing::upload(&task, b"late"), None).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Unavailable, "{error}");
    assert!(store.lost().is_cancelled());
    let reason = store.verify().unwrap_err();
    assert!(reason.kind() == Kind::Precondition && reason.message().contains("earlier copy"), "{reason}");
    assert_eq!(server.execute(&name, "select count(*) from uploads"), "0");
}

#[tokio::test]
async fn unusable_databases_are_refused_with_the_remedy() {
    if !selected() {
        return;
    }
    let server = gleaner_test_postgres::shared();
    let wrong = server.url_as(&format!("{GUARDED_ROLE}:hunter2"), "postgres");
    let error = refused(&wrong).await;
    assert!(error.message().contains("--database-password-file") && !error.to_string().contains("hunter2"), "{error}");

    let error = refused(&server.url("nowhere")).await;
    assert!(error.message().contains("createdb"), "{error}");

    let error = refused("postgres://gleaner:hunter2@127.0.0.1:1/gleaner").await;
    assert!(error.message().contains("--database") && !error.to_string().contains("hunter2"), "{error}");

    let foreign = server.database();
    server.execute(&foreign, "create table songs (name text)");
    let error = refused(&server.url(&foreign)).await;
    assert!(error.message().contains("tables of another program"), "{error}");
    assert_eq!(server.execute(&foreign, "select count(*) from pg_tables where schemaname = 'public'"), "1");

    let newer = server.database();
    Store::serve_postgres(&Postgres::at(&server.url(&newer)).unwrap()).await.unwrap().close().await;
    let version = schema::newest() + 5;
    let insert = "insert into _sqlx_migrations (version, description, success, checksum, execution_time)";
    server.execute(&newer, &format!("{insert} values ({version}, 'tomorrow', true, '', 1)"));
    let error = refused(&server.url(&newer)).await;
    assert!(error.message().contains(&version.to_string()), "{error}");
}

#[tokio::test]
async fn passwords_come_from_a_file_and_are_never_shown() {
    if !selected() {
        return;
    }
    let server = gleaner_test_postgres::shared();
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("password");
    fs::write(&file, format!("{PASSWORD}\n")).unwrap();
    let url = server.url_as(&format!("{GUARDED_ROLE}:hunter2"), &server.database());
    let config =
        DatabaseConfig { database: Some(url.into()), database_password_file: Some(file), ..DatabaseConfig::default() };
    let at = Postgres::configured(&config).unwrap().unwrap();
    Store::serve_postgres(&at).await.unwrap().close().await;
    for shown in [at.to_string(), format!("{at:?}"), format!("{config:?}")] {
        assert!(!shown.contains("hunter2") && !shown.contains(PASSWORD), "{shown}");
    }
    let missing = DatabaseConfig { database_password_file: Some(dir.path().join("none")), ..config };
    let error = Postgres::configured(&missing).unwrap_err();
    assert!(error.kind() == Kind::Invalid && error.to_string().contains("--database-password-file"), "{error}");
}

#[tokio::test]
async fn texts_with_a_nul_character_are_invalid() {
    if !selected() {
        return;
    }
    let store = Store::serve_postgres(&testing::postgres().await).await.unwrap();
    let spec = gleaner_recording::TaskSpec { name: "a\0b".into(), ..testing::spec() };
    let error = store.insert_task(&spec).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Invalid, "{error}");
}

#[test]
fn unknown_parameters_of_an_address_are_named_without_their_values() {
    let error = Postgres::at("postgres://gleaner@db/lab?sslpassword=secret-1").unwrap_err();
    assert!(error.message().contains("sslpassword") && !error.to_string().contains("secret-1"), "{error}");
    let error = Postgres::at("postgres://gleaner:secret?two=3@db/lab").unwrap_err();
    assert!(error.message().contains("%3F") && !error.to_string().contains("two"), "{error}");
    Postgres::at("postgres://gleaner@db/lab?sslmode=verify-full&host=/run/postgresql").unwrap();
}

#[test]
fn programs_get_the_address_without_its_password() {
    for (url, shown, password) in [
        (
            "postgres://ada:a%20b%2Fc%@db:5/lab?sslmode=disable",
            "postgres://ada@db:5/lab?sslmode=disable",
            Some("a b/c%"),
        ),
        ("postgres://ada@db/lab", "postgres://ada@db/lab", None),
        ("postgres:///lab?host=/run/a:b", "postgres:///lab?host=/run/a:b", None),
    ] {
        let at = Postgres::at(url).unwrap();
        assert_eq!(at.shown_url(), shown);
        assert_eq!(at.password.as_ref().map(Secret::reveal), password);
    }
}

/// The second statement of a beginning waits for a lock longer than it may, and leaves its transaction aborted.
#[tokio::test]
async fn a_beginning_that_fails_does_not_stop_later_writes() {
    if !selected() {
        return;
    }
    let at = testing::postgres().await;
    let store = Store::serve_postgres(&at).await.unwrap();
    let other = Store::open_beside(&at).await.unwrap();
    super::super::sql::query("set lock_timeout = '50ms'").execute(&store.writer).await.unwrap();
    let held = other.write().await.unwrap();
    assert_eq!(store.write().await.map(drop).unwrap_err().kind(), Kind::Unavailable);
    drop(held);
    testing::task(&store).await;
    assert_eq!(store.tasks().await.unwrap().len(), 1);
}
