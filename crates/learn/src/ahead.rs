//! Batches that are assembled ahead of the steps that use them, on a thread of their own. Independent of the content of a
//! batch.
//!
//! A batch depends on its number alone, so a run gives the same bytes as one that assembles each batch when it is due.

use std::ops::Range;
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::{Duration, Instant};

use crate::device;
use crate::error::{LearnError, guard};

/// Batches that wait for their step in a training. With the next one, which the thread assembles or holds, and that of
/// the present step, three batches are in memory at once.
pub(crate) const WAITING: usize = 1;

/// A batch, and how long its thread took for it.
pub(crate) struct Assembled<B> {
    pub(crate) batch: B,
    pub(crate) took: Duration,
}

/// Returns the next batch, and waits for it if it is not assembled yet.
pub(crate) type Next<'a, B> = &'a mut dyn FnMut() -> Result<Assembled<B>, LearnError>;

/// Runs `work` on this thread while another one assembles the batches with these numbers, in their order, of which up to
/// `waiting` wait. The other thread computes on one processor, and ends with `work` after at most the batch that it is
/// assembling.
///
/// # Errors
/// Those of `work`, and [`LearnError::Thread`]. An error or a panic of `assemble` is the error of the batch.
pub(crate) fn ahead<B: Send, R>(
    (numbers, waiting): (Range<u64>, usize),
    assemble: impl Fn(u64) -> Result<B, LearnError> + Send,
    work: impl FnOnce(Next<'_, B>) -> Result<R, LearnError>,
) -> Result<R, LearnError> {
    thread::scope(|scope| {
        let (sender, receiver) = sync_channel(waiting);
        let assembling = move || {
            for number in numbers {
                let begin = Instant::now();
                let batch = guard(|| assemble(number)).map(|batch| Assembled { batch, took: begin.elapsed() });
                let failed = batch.is_err();
                // Sending fails once `work` has ended.
                if sender.send(batch).is_err() || failed {
                    return;
                }
            }
        };
        device::spawn_single(scope, assembling).map_err(LearnError::Thread)?;
        let beyond = |_| Err(LearnError::Torch("a batch after the last one of the run was requested".to_owned()));
        work(&mut || receiver.recv().unwrap_or_else(beyond))
    })
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn batches_come_in_order_and_end_with_the_run() {
        let found = ahead(
            (3..7, WAITING),
            |number| Ok(number * 10),
            |next| {
                let batches = [next()?, next()?, next()?, next()?].map(|assembled| assembled.batch);
                assert!(matches!(next(), Err(LearnError::Torch(_))));
                Ok(batches)
            },
        );
        assert_eq!(found.unwrap(), [30, 40, 50, 60]);
    }

    #[test]
    fn two_batches_are_ahead_of_the_step_and_no_more() {
        let (assembled, seen) = channel();
        let assemble = move |number| {
            assembled.send(number).unwrap();
            Ok(number)
        };
        let work = |next: Next<'_, u64>| {
            // Two are assembled before any is taken, and each one taken makes room for one.
            assert_eq!((seen.recv(), seen.recv()), (Ok(0), Ok(1)));
            assert!(seen.try_recv().is_err());
            next()?;
            assert_eq!(seen.recv(), Ok(2));
            assert!(seen.try_recv().is_err());
            Ok(())
        };
        ahead((0..100, WAITING), assemble, work).unwrap();
        // The thread ended without the other 97.
        assert_eq!(seen.iter().count(), 0);
    }

    #[test]
    fn work_that_ends_early_ends_the_thread() {
        let stopped = ahead((0..u64::MAX, WAITING), Ok, |next| next().and(Err::<(), _>(LearnError::Cancelled)));
        assert!(matches!(stopped, Err(LearnError::Cancelled)));
        let panics = guard(|| ahead((0..u64::MAX, WAITING), Ok, |_| -> Result<(), _> { panic!("of the work") }));
        assert!(panics.unwrap_err().to_string().ends_with("of the work"));
    }

    #[test]
    fn a_panic_while_assembling_is_the_error_of_its_batch() {
        let assemble = |number| {
            assert!(number < 2, "batch {number} cannot be assembled");
            Ok(number)
        };
        let mut done = Vec::new();
        let failed = ahead((0..u64::MAX, WAITING), assemble, |next| -> Result<(), _> {
            loop {
                done.push(next()?.batch);
            }
        });
        assert!(failed.unwrap_err().to_string().ends_with("batch 2 cannot be assembled"));
        assert_eq!(done, [0, 1]);
    }

    #[test]
    fn the_thread_has_one_thread_of_the_tensor_library_and_the_caller_keeps_its_own() {
        let caller = tch::get_num_threads();
        let threads =
            ahead((0..1, WAITING), |_| Ok(tch::get_num_threads()), |next| Ok((next()?.batch, tch::get_num_threads())));
        assert_eq!(threads.unwrap(), (1, caller));
    }
}
