//! Interruptions by the keyboard or the system, of commands that have something to remove or to stop first.

use tokio::signal::unix::{SignalKind, signal};

use crate::failure::{Failure, Result};

/// The result of the work, or a failure with this message if the keyboard or the system asks to stop first.
pub(crate) async fn unless_interrupted<T>(
    work: impl Future<Output = Result<T>>,
    interrupted: &'static str,
) -> Result<T> {
    let mut terminate = signal(SignalKind::terminate())?;
    let stop = async {
        tokio::select! {
            _ = tokio::signal::ctrl_c() => {}
            _ = terminate.recv() => {}
        }
    };
    unless(work, stop, interrupted).await
}

/// The result of the work, or a failure if `stop` completes first. The work is then dropped, and with it its temporary files
/// and its children.
async fn unless<T>(
    work: impl Future<Output = Result<T>>,
    stop: impl Future<Output = ()>,
    stopped: &'static str,
) -> Result<T> {
    tokio::select! {
        done = work => done,
        () = stop => Err(Failure::message(stopped)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn interrupted_work_leaves_no_temporary_files() {
        let folder = tempfile::tempdir().unwrap();
        let (begun, begins) = tokio::sync::oneshot::channel();
        let work = async {
            let copies = tempfile::tempdir_in(folder.path())?;
            std::fs::write(copies.path().join("episode.mcap"), "steps")?;
            begun.send(copies.path().join("episode.mcap")).unwrap();
            std::future::pending::<()>().await;
            drop(copies);
            Ok(())
        };
        let stop = async { assert!(begins.await.unwrap().is_file()) };
        let message = unless(work, stop, "interrupted").await.unwrap_err().to_string();
        assert_eq!(message, "interrupted");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
