//! When a request reached each stage on its way through the model: the source of its timings.

use std::{
    sync::OnceLock,
    time::{Duration, Instant},
};

use crate::domain::observation::Timings;

/// The stages of one request, each written once by the current holder of the request.
#[derive(Debug)]
pub(super) struct Stages {
    arrived: Instant,
    decode: OnceLock<Duration>,
    entered: OnceLock<Entered>,
    left: OnceLock<Instant>,
}

#[derive(Debug)]
struct Entered {
    at: Instant,
    /// How long the free model waited for other requests after this one arrived.
    gathered: Duration,
    batch_size: u32,
}

impl Stages {
    /// For a request that arrives now.
    pub(super) fn begin() -> Self {
        Self { arrived: Instant::now(), decode: OnceLock::new(), entered: OnceLock::new(), left: OnceLock::new() }
    }

    pub(super) fn arrived(&self) -> Instant {
        self.arrived
    }

    /// Notes the time that decoding took.
    pub(super) fn decoded(&self, took: Duration) {
        // Each stage is reached once; an input that is run again after its batch failed keeps the first time.
        let _ = self.decode.set(took);
    }

    /// Notes the entry into the model with a batch of this size.
    pub(super) fn enters(&self, gathered: Duration, batch_size: usize) {
        let batch_size = u32::try_from(batch_size).unwrap_or(u32::MAX);
        let _ = self.entered.set(Entered { at: Instant::now(), gathered, batch_size });
    }

    /// Notes the model's end.
    pub(super) fn leaves(&self) {
        let _ = self.left.set(Instant::now());
    }

    /// The timings until now. Time that is not decoding, gathering or the model counts as queueing.
    pub(super) fn timings(&self) -> Timings {
        let now = Instant::now();
        let decode = self.decode.get().copied().unwrap_or_default();
        let (waited, gathered, model, batch_size) = match self.entered.get() {
            None => (now - self.arrived, Duration::ZERO, Duration::ZERO, 0),
            Some(entered) => {
                let left = self.left.get().copied().unwrap_or(now);
                let model = left.saturating_duration_since(entered.at);
                (entered.at - self.arrived, entered.gathered, model, entered.batch_size)
            }
        };
        Timings {
            decode_us: micros(decode),
            queue_us: micros(waited.saturating_sub(decode).saturating_sub(gathered)),
            batch_us: micros(gathered),
            model_us: micros(model),
            total_us: micros(now - self.arrived),
            batch_size,
        }
    }
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stages_add_up() {
        let stages = Stages::begin();
        let early = stages.timings();
        assert_eq!((early.decode_us, early.batch_us, early.model_us, early.batch_size), (0, 0, 0, 0));
        stages.decoded(Duration::from_micros(1));
        stages.enters(Duration::ZERO, 3);
        stages.leaves();
        let Timings { decode_us, queue_us, batch_us, model_us, total_us, batch_size } = stages.timings();
        assert_eq!((batch_us, batch_size), (0, 3));
        assert!(decode_us <= 1 && queue_us + model_us <= total_us, "{queue_us} + {model_us} of {total_us}");
    }
}
