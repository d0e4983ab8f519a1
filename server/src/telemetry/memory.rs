//! The memory of processes, for the metrics.

use std::{convert::Infallible, time::Duration};

/// The interval of sampling a worker.
const EVERY: Duration = Duration::from_secs(5);

/// Resident bytes of a process; `None` where the system does not report it, or the process has ended.
pub(crate) fn resident(pid: u32) -> Option<u64> {
    let statm = std::fs::read_to_string(format!("/proc/{pid}/statm")).ok()?;
    let pages: u64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    let page = u64::try_from(rustix::param::page_size()).ok()?;
    Some(pages * page)
}

/// Samples the memory of a worker for as long as it is polled.
pub(crate) async fn of_worker(pid: u32, kind: &'static str) -> Infallible {
    let mut share = Share::new(kind);
    loop {
        share.is(resident(pid).unwrap_or(0));
        tokio::time::sleep(EVERY).await;
    }
}

/// One worker's share in the gauge of its kind; subtracted on drop.
struct Share {
    gauge: metrics::Gauge,
    bytes: f64,
}

impl Share {
    fn new(kind: &'static str) -> Self {
        Self { gauge: metrics::gauge!("gleaner_worker_memory_bytes", "kind" => kind), bytes: 0.0 }
    }

    #[expect(clippy::cast_precision_loss, reason = "far below 2^52 bytes")]
    fn is(&mut self, bytes: u64) {
        let bytes = bytes as f64;
        self.gauge.increment(bytes - self.bytes);
        self.bytes = bytes;
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.gauge.decrement(self.bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_memory_of_a_running_process_is_known_and_that_of_a_missing_one_is_not() {
        assert!(resident(std::process::id()).is_some_and(|bytes| bytes > 1 << 20));
        assert_eq!(resident(u32::MAX), None);
    }

    #[test]
    fn the_memory_of_workers_of_a_kind_is_summed() {
        let recorder = metrics_exporter_prometheus::PrometheusBuilder::new().build_recorder();
        let shown = |bytes: &str| {
            let page = recorder.handle().render();
            assert!(page.contains(&format!("gleaner_worker_memory_bytes{{kind=\"train\"}} {bytes}\n")), "{page}");
        };
        metrics::with_local_recorder(&recorder, || {
            let (mut one, mut other) = (Share::new("train"), Share::new("train"));
            one.is(100);
            other.is(50);
            one.is(70);
            shown("120");
            drop(one);
            shown("50");
        });
    }
}
