//! Interruptions by the keyboard or the system, of commands that have something to remove or to stop first.

use rustix::process::Signal;
use tokio::signal::unix::{self, SignalKind, signal};

use crate::failure::{Failure, Result};

/// The result of the work, or a failure with this message if the keyboard or the system asks to stop first.
pub(crate) async fn unless_interrupted<T>(
    work: impl Future<Output = Result<T>>,
    interrupted: &'static str,
) -> Result<T> {
    // Both are received from here on, also before the first poll of the work.
    let mut signals = Signals::listen()?;
    unless(work, signals.next(), interrupted).await
}

/// The signals that ask a command to stop. They end the process no longer, and none is lost between two waits.
pub(crate) struct Signals {
    keyboard: unix::Signal,
    terminate: unix::Signal,
}

impl Signals {
    pub(crate) fn listen() -> Result<Self> {
        Ok(Self { keyboard: signal(SignalKind::interrupt())?, terminate: signal(SignalKind::terminate())? })
    }

    /// The next of them since the last wait or the beginning.
    pub(crate) async fn next(&mut self) -> Signal {
        tokio::select! {
            _ = self.keyboard.recv() => Signal::INT,
            _ = self.terminate.recv() => Signal::TERM,
        }
    }
}

/// The result of the work, or a failure if `stop` completes first. The work is then dropped, and with it its temporary files
/// and its children.
pub(crate) async fn unless<T>(
    work: impl Future<Output = Result<T>>,
    stop: impl Future<Output = Signal>,
    message: &'static str,
) -> Result<T> {
    tokio::select! {
        // First, because the keyboard interrupts the children too, and their end is a result of the work.
        biased;
        signal = stop => Err(Failure::Interrupted { signal, message }),
        done = work => done,
    }
}

/// Held by tests that send such signals to their own process, and by those that listen to them and must receive no others.
#[cfg(test)]
pub(crate) static ALONE: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());

#[cfg(test)]
mod tests {
    use rustix::process::{getpid, kill_process};

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
        let stop = async {
            assert!(begins.await.unwrap().is_file());
            Signal::INT
        };
        let message = unless(work, stop, "interrupted").await.unwrap_err().to_string();
        assert_eq!(message, "interrupted");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[tokio::test]
    async fn an_interrupted_command_has_the_exit_code_of_its_signal() {
        let _alone = ALONE.lock().await;
        for (signal, code) in [(Signal::INT, 130), (Signal::TERM, 143)] {
            let work = async {
                kill_process(getpid(), signal).unwrap();
                std::future::pending::<Result<()>>().await
            };
            let failure = unless_interrupted(work, "interrupted").await.unwrap_err();
            assert_eq!((failure.exit_code(), failure.to_string()), (code, "interrupted".to_owned()));
        }
        assert_eq!(Failure::message("no tasks yet").exit_code(), 1);
    }
}
