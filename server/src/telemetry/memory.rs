//! How much memory processes take, for the metrics.

use std::{convert::Infallible, time::Duration};

/// How often a worker is looked at.
const EVERY: Duration = Duration::from_secs(5);

/// Resident bytes of a process; `None` where the system does not say, or it has gone.
pub(crate) fn resident(pid: u32) -> Option<u64> {
    let statm = std::fs::read_to_string(format!("/proc/{pid}/statm")).ok()?;
    let pages: u64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    let page = u64::try_from(rustix::param::page_size()).ok()?;
    Some(pages * page)
}

/// Watches the memory of a worker for as long as it is polled.
pub(crate) async fn of_worker(pid: u32, kind: &'static str) -> Infallible {
    let gauge = Gone(metrics::gauge!("gleaner_worker_memory_bytes", "kind" => kind));
    loop {
        #[expect(clippy::cast_precision_loss, reason = "far below 2^52 bytes")]
        gauge.0.set(resident(pid).unwrap_or(0) as f64);
        tokio::time::sleep(EVERY).await;
    }
}

/// A gauge that falls to nothing when its worker has ended.
struct Gone(metrics::Gauge);

impl Drop for Gone {
    fn drop(&mut self) {
        self.0.set(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_has_memory_and_one_that_is_not_there_has_none() {
        assert!(resident(std::process::id()).is_some_and(|bytes| bytes > 1 << 20));
        assert_eq!(resident(u32::MAX), None);
    }
}
