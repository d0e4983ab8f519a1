//! A private PostgreSQL for tests. Where PostgreSQL is not installed, they print SKIPPED.

use gleaner_test_postgres::Server;

use super::skipped::skipped;

/// A private PostgreSQL and the address of a new database in it.
pub fn postgres() -> Option<(Server, String)> {
    if let Some(reason) = gleaner_test_postgres::missing() {
        skipped(&reason);
        return None;
    }
    let server = Server::start();
    let url = server.url(&server.database());
    Some((server, url))
}
