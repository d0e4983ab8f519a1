//! Fail points: named places between durable steps at which a test kills this process, as a power cut would.
//!
//! Only the feature `fail-points`, which the tests alone enable, compiles them in. Must not depend on other modules.

/// Every fail point. Each is at one place of the sources.
pub const NAMES: [&str; 67] = [
    "attempt.committed",
    "attempt.row_written",
    "blob.folder_synced",
    "blob.in_bucket",
    "blob.removed",
    "blob.renamed",
    "blob.synced",
    "blob.written",
    "cancel.committed",
    "cancel.row_written",
    "checkpoint.blob_kept",
    "checkpoint.committed",
    "checkpoint.earlier_forgotten",
    "checkpoint.row_written",
    "claim.committed",
    "claim.row_written",
    "dataset.committed",
    "dataset.row_written",
    "deployment.committed",
    "deployment.row_written",
    "episode.committed",
    "episode.row_written",
    "frames.renamed",
    "frames.synced",
    "import.committed",
    "import.rows_written",
    "jobs.committed",
    "jobs.rows_written",
    "label.committed",
    "label.rows_written",
    "process.committed",
    "process.row_written",
    "progress.committed",
    "progress.rows_written",
    "result.blob_kept",
    "result.committed",
    "result.rows_written",
    "rollout.committed",
    "rollout.kept",
    "rollout.linked",
    "rollout.sidecar_drafted",
    "rollout.sidecar_renamed",
    "rollout.synced",
    "sidecar.removed",
    "sidecar.renamed",
    "snapshot.committed",
    "snapshot.rows_written",
    "stamp.put",
    "stamp.raised",
    "sweep.committed",
    "sweep.rows_removed",
    "trash.blob_deleted",
    "trash.moved",
    "trash.sidecars_moved",
    "upload.blob_placed",
    "upload.blob_sent",
    "upload.bytes_synced",
    "upload.bytes_written",
    "upload.digest_checked",
    "upload.frames_kept",
    "upload.inspected",
    "upload.part_made",
    "upload.part_removed",
    "upload.row_made",
    "upload.row_removed",
    "upload.size_committed",
    "worker.started",
];

/// The variable in which tests name a fail point; workers inherit it.
pub const VARIABLE: &str = "GLEANER_FAIL_POINT";

/// Passes a fail point.
#[inline]
pub fn pass(name: &'static str) {
    #[cfg(feature = "fail-points")]
    fail::fail_point!(name);
    #[cfg(not(feature = "fail-points"))]
    let _ = name;
}

/// Makes this process die at the n-th passing of a fail point, `name` or `name=n`, together with the process `parent`,
/// if given.
///
/// # Errors
/// A sentence that states the mistake.
#[cfg(feature = "fail-points")]
pub fn arm(which: &str, parent: Option<u32>) -> Result<(), String> {
    armed::arm(which, parent.and_then(|id| i32::try_from(id).ok()).and_then(rustix::process::Pid::from_raw))
}

#[cfg(feature = "fail-points")]
mod armed {
    use std::sync::atomic::{AtomicU64, Ordering};

    use rustix::process::{Pid, Signal, getpid, kill_process};

    use super::NAMES;

    /// Kills this process at the n-th passing of `name=n`, and before it the server that started it.
    pub(super) fn arm(which: &str, server: Option<Pid>) -> Result<(), String> {
        let (name, count) = which.split_once('=').unwrap_or((which, "1"));
        let count: u64 = count.parse().map_err(|_| format!("fail point {which}: {count} is not a number"))?;
        if !NAMES.contains(&name) {
            return Err(format!("fail point {name}: unknown name; `fail_point::NAMES` lists them"));
        }
        let passed = AtomicU64::new(0);
        fail::cfg_callback(name, move || {
            if passed.fetch_add(1, Ordering::Relaxed) + 1 == count {
                // The server first, so that it cannot react to the death of its worker.
                for process in server.into_iter().chain([getpid()]) {
                    // A process that has already ended needs no signal.
                    let _ = kill_process(process, Signal::KILL);
                }
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::NAMES;

    fn sources(folder: &Path, text: &mut String) {
        for entry in folder.read_dir().unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                sources(&path, text);
            } else if path.extension().is_some_and(|ending| ending == "rs") && !path.ends_with("fail_point.rs") {
                text.push_str(&std::fs::read_to_string(path).unwrap());
            }
        }
    }

    #[test]
    fn every_fail_point_occurs_once_in_the_sources() {
        let mut text = String::new();
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        sources(&root.join("server/src"), &mut text);
        sources(&root.join("crates"), &mut text);
        let mut passed: Vec<&str> =
            text.split("fail_point::pass(\"").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
        passed.sort_unstable();
        assert_eq!(passed, NAMES);
    }

    #[cfg(feature = "fail-points")]
    #[test]
    fn unknown_fail_points_are_rejected() {
        for wrong in ["blob.cut", "blob.synced=x", ""] {
            assert!(super::armed::arm(wrong, None).unwrap_err().starts_with("fail point "), "{wrong}");
        }
        super::armed::arm("blob.synced=18446744073709551615", None).unwrap();
        super::pass("blob.synced");
    }
}
