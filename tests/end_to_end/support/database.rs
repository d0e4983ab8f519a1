//! The database of the servers under test: SQLite, or PostgreSQL where `GLEANER_TEST_DATABASE` selects it.

use std::path::Path;

/// The variables that name the database of a data folder in PostgreSQL; none for SQLite.
pub fn of(data: &Path) -> Option<(&'static str, String)> {
    let name = || format!("lab_{}", &blake3::hash(data.as_os_str().as_encoded_bytes()).to_hex()[..16]);
    gleaner_test_postgres::selected()
        .then(|| ("GLEANER_DATABASE", gleaner_test_postgres::shared().database_named(&name())))
}
