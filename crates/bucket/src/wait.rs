//! Waits for the client of the store, which is asynchronous, on a blocking thread.

use std::sync::{OnceLock, mpsc};

use gleaner_core::error::{Error, Result};
use tokio::runtime::{Builder, Runtime};

/// Threads for the transfers of this process.
const THREADS: usize = 2;

/// Runs a future on the threads of transfers and returns its output. A runtime of their own, because callers are partly
/// on a runtime's threads, which must not start one, and partly on none.
///
/// # Errors
/// Internal when the threads cannot be started, or the future panics.
pub(crate) fn wait<T: Send + 'static>(future: impl Future<Output = T> + Send + 'static) -> Result<T> {
    static RUNTIME: OnceLock<std::io::Result<Runtime>> = OnceLock::new();
    let runtime = RUNTIME.get_or_init(|| {
        Builder::new_multi_thread().worker_threads(THREADS).thread_name("transfers").enable_all().build()
    });
    let runtime = runtime.as_ref().map_err(|error| Error::internal("starting transfers", error.to_string()))?;
    let (sender, receiver) = mpsc::sync_channel(1);
    runtime.spawn(async move {
        // The receiver waits until it has the output.
        let _ = sender.send(future.await);
    });
    receiver.recv().map_err(|error| Error::internal("waiting for a transfer", error))
}
