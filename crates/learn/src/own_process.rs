//! Tests that run in processes of their own: what they set belongs to their process alone, and a process that a signal ends
//! is a failure of the test by its name. For tests only.

use std::process::Command;

/// Set in the process of a test's own.
const ALONE: &str = "GLEANER_TEST_ALONE";

/// Whether this process runs the calling test alone; if not, the test has passed in a process that does.
pub(crate) fn in_own_process() -> bool {
    if std::env::var_os(ALONE).is_some() {
        return true;
    }
    let thread = std::thread::current();
    let test = thread.name().expect("a test's thread has its name");
    let mut command = Command::new(std::env::current_exe().unwrap());
    let ended = command.args(["--exact", test]).env(ALONE, "1").output().unwrap();
    let [output, errors] = [&ended.stdout, &ended.stderr].map(|text| String::from_utf8_lossy(text));
    assert!(ended.status.success() && output.contains("1 passed"), "{test}: {}\n{output}{errors}", ended.status);
    false
}
