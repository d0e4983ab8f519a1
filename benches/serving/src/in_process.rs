//! The model alone, in this process, on the very checkpoint that the server serves: what a request would cost if
//! serving it cost nothing.

use std::time::{Duration, Instant};

use gleaner_learn::{History, Policy, set_threads};

use crate::Result;
use crate::load::{quantile, times};
use crate::prepare::Prepared;
use crate::scene::Step;

/// A policy and one session's history.
pub(crate) struct InProcess {
    policy: Policy,
    history: History,
    taken: Vec<Duration>,
}

impl InProcess {
    /// Loads it on this thread, with one thread for its tensors, as the server does.
    pub(crate) fn load(prepared: &Prepared) -> Result<Self> {
        set_threads(1);
        let policy = Policy::load(&prepared.checkpoint)?;
        let history = History::new(policy.segment_length());
        Ok(Self { policy, history, taken: Vec::new() })
    }

    /// Answers requests for `slice`, after a quarter of it to warm up.
    pub(crate) fn add(&mut self, steps: &[Step], slice: Duration) -> Result<()> {
        let from = Instant::now() + slice / 4;
        for step in steps.iter().cycle() {
            let begun = Instant::now();
            if begun >= from + slice {
                break;
            }
            self.answer(step)?;
            if begun >= from {
                self.taken.push(begun.elapsed());
            }
        }
        Ok(())
    }

    /// What [`InProcess::add`] measured since the last call: the median, in milliseconds.
    pub(crate) fn take_median(&mut self) -> f64 {
        quantile(&times(std::mem::take(&mut self.taken).into_iter()), 0.5)
    }

    /// One request: its frame is encoded, then one pass over the history.
    fn answer(&mut self, step: &Step) -> Result<()> {
        let embedding = self.policy.embed(&[&step.frames])?.pop().ok_or("no embedding")?;
        self.history.push(embedding, step.proprioception.clone())?;
        let action = self.policy.act(&[&self.history])?.pop().and_then(|chunk| chunk.into_iter().next());
        Ok(self.history.set_executed(action.ok_or("no action")?)?)
    }
}
