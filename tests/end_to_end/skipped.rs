//! What this machine does not let a test look at, said where a passing test's own output would not be seen.

use std::io::Write as _;

/// Says it on standard error, past the harness.
#[expect(clippy::explicit_write, reason = "the harness swallows what the macro writes")]
pub fn skipped(why: &str) {
    writeln!(std::io::stderr(), "SKIPPED: {why}").unwrap();
}
