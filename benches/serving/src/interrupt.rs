//! Interruptions by the keyboard or the system: servers are stopped and folders removed before the bench ends.

use tokio::signal::unix::{SignalKind, signal};

use crate::Result;

/// The result of the work, or a failure once the keyboard or the system asks the bench to stop. The work is then dropped, and
/// with it its servers and its temporary folder.
pub async fn unless_interrupted<T>(work: impl Future<Output = Result<T>>) -> Result<T> {
    // Both are received from here on, also before the first poll of the work.
    let (mut keyboard, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    tokio::select! {
        done = work => done,
        _ = keyboard.recv() => Err("interrupted".into()),
        _ = terminate.recv() => Err("terminated".into()),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use rustix::process::{Signal, getpid, kill_process};

    use super::*;

    /// The signals are sent to the process of the tests itself, in which no other test receives them.
    #[tokio::test]
    async fn interrupted_work_leaves_no_temporary_folder() {
        for (signal, message) in [(Signal::INT, "interrupted"), (Signal::TERM, "terminated")] {
            let folder = tempfile::tempdir().unwrap();
            let work = async {
                let data = tempfile::tempdir_in(folder.path())?;
                std::fs::write(data.path().join("server.log"), "started")?;
                kill_process(getpid(), signal)?;
                std::future::pending::<()>().await;
                drop(data);
                Ok(())
            };
            assert_eq!(unless_interrupted(work).await.unwrap_err().to_string(), message);
            assert_eq!(folder.path().read_dir().unwrap().count(), 0);
        }
    }
}
