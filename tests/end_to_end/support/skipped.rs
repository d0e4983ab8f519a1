//! Tests that cannot run on this machine: the reason is printed even though the test passes.

use std::io::Write as _;

/// Prints the reason on standard error, which the test harness does not capture.
#[expect(clippy::explicit_write, reason = "the harness captures the output of the macros")]
pub fn skipped(reason: &str) {
    writeln!(std::io::stderr(), "SKIPPED: {reason}").unwrap();
}
