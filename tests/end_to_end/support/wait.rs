//! Waits for events. Every wait has a limit; a test whose event does not happen fails with a description of it.

use std::time::Duration;

/// Far more than any event of the tests takes on a machine that is busy with other tests.
pub const LIMIT: Duration = Duration::from_secs(240);

/// Waits for a future.
pub async fn within<T>(event: &str, future: impl Future<Output = T>) -> T {
    let Ok(output) = tokio::time::timeout(LIMIT, future).await else { panic!("not within {LIMIT:?}: {event}") };
    output
}

/// Polls until there is a value. Other tasks run between two polls.
pub async fn until<T>(event: &str, mut poll: impl AsyncFnMut() -> Option<T>) -> T {
    let polling = async {
        loop {
            if let Some(value) = poll().await {
                return value;
            }
            tokio::task::yield_now().await;
        }
    };
    within(event, polling).await
}
