//! Batches that are assembled ahead of the steps that use them, on threads of their own. Independent of the content of a
//! batch.
//!
//! A batch depends on its number alone, so a run gives the same bytes as one that assembles each batch when it is due, with
//! any number of threads.

use std::ops::Range;
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::{Duration, Instant};

use crate::device;
use crate::error::{LearnError, guard};

/// Batches of each of these threads that wait for their step in a training, beside the one that the thread assembles or
/// holds. With that of the present step, three batches are in memory at once for one thread, and n + 1 for n threads.
pub(crate) fn waiting(threads: usize) -> usize {
    usize::from(threads == 1)
}

/// A batch, and how long its thread took for it.
pub(crate) struct Assembled<B> {
    pub(crate) batch: B,
    pub(crate) took: Duration,
}

/// Returns the next batch, and waits for it if it is not assembled yet.
pub(crate) type Next<'a, B> = &'a mut dyn FnMut() -> Result<Assembled<B>, LearnError>;

/// Runs `work` on this thread while each of `assemblers`, on a thread of its own, assembles the batches with these numbers
/// in turn, of which up to `waiting` wait. `work` has them in their order. A thread computes on one processor, and ends with
/// `work` after at most the batch that it is assembling.
///
/// # Errors
/// Those of `work`, and [`LearnError::Thread`]. An error or a panic of an assembler is the error of the batch.
pub(crate) fn ahead<B: Send, R>(
    (numbers, waiting): (Range<u64>, usize),
    assemblers: Vec<impl Fn(u64) -> Result<B, LearnError> + Send>,
    work: impl FnOnce(Next<'_, B>) -> Result<R, LearnError>,
) -> Result<R, LearnError> {
    let threads = assemblers.len();
    thread::scope(|scope| {
        let mut receivers = Vec::with_capacity(threads);
        for (place, assemble) in assemblers.into_iter().enumerate() {
            let (sender, receiver) = sync_channel(waiting);
            let numbers = numbers.clone().skip(place).step_by(threads);
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
            receivers.push(receiver);
        }
        let mut turns = receivers.iter().cycle();
        let beyond = || LearnError::Torch("a batch after the last one of the run was requested".to_owned());
        work(&mut || turns.next().and_then(|thread| thread.recv().ok()).unwrap_or_else(|| Err(beyond())))
    })
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn batches_come_in_order_and_end_with_the_run() {
        let found = ahead((3..7, 1), vec![|number| Ok(number * 10)], |next| {
            let batches = [next()?, next()?, next()?, next()?].map(|assembled| assembled.batch);
            assert!(matches!(next(), Err(LearnError::Torch(_))));
            Ok(batches)
        });
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
        ahead((0..100, waiting(1)), vec![assemble], work).unwrap();
        // The thread ended without the other 97.
        assert_eq!(seen.iter().count(), 0);
    }

    #[test]
    fn work_that_ends_early_ends_the_thread() {
        let stopped = ahead((0..u64::MAX, 1), vec![Ok], |next| next().and(Err::<(), _>(LearnError::Cancelled)));
        assert!(matches!(stopped, Err(LearnError::Cancelled)));
        let panics = guard(|| ahead((0..u64::MAX, 1), vec![Ok], |_| -> Result<(), _> { panic!("of the work") }));
        assert!(panics.unwrap_err().to_string().ends_with("of the work"));
    }

    #[test]
    fn a_panic_while_assembling_is_the_error_of_its_batch() {
        let assemble = |number| {
            assert!(number < 2, "batch {number} cannot be assembled");
            Ok(number)
        };
        let mut done = Vec::new();
        let failed = ahead((0..u64::MAX, 1), vec![assemble], |next| -> Result<(), _> {
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
            ahead((0..1, 1), vec![|_| Ok(tch::get_num_threads())], |next| Ok((next()?.batch, tch::get_num_threads())));
        assert_eq!(threads.unwrap(), (1, caller));
    }

    /// Assemblers that return their place and the number of the batch.
    fn places(count: u64) -> Vec<impl Fn(u64) -> Result<(u64, u64), LearnError> + Send> {
        (0..count).map(|place| move |number| Ok((place, number))).collect()
    }

    #[test]
    fn several_threads_take_turns_and_their_batches_come_in_order() {
        let found = ahead((5..12, waiting(3)), places(3), |next| {
            let batches: Result<Vec<_>, _> = (5..12).map(|_| next().map(|assembled| assembled.batch)).collect();
            assert!(matches!(next(), Err(LearnError::Torch(_))));
            batches
        });
        assert_eq!(found.unwrap(), [(0, 5), (1, 6), (2, 7), (0, 8), (1, 9), (2, 10), (0, 11)]);
    }

    #[test]
    fn several_threads_assemble_at_once_a_batch_each() {
        // Each of the first three batches waits for the other two: on fewer threads than three this would not end.
        let (together, (assembled, seen)) = (std::sync::Barrier::new(3), channel());
        let assemblers = (0..3).map(|_| {
            let (together, assembled) = (&together, assembled.clone());
            move |number| {
                assembled.send(number).unwrap();
                if number < 3 {
                    together.wait();
                }
                Ok(number)
            }
        });
        let work = |next: Next<'_, u64>| {
            let mut first: Vec<u64> = seen.iter().take(3).collect();
            first.sort_unstable();
            assert_eq!(first, [0, 1, 2]);
            // No thread begins another before its batch is taken.
            let begins_none = || assert!(seen.recv_timeout(Duration::from_millis(20)).is_err());
            begins_none();
            next()?;
            assert_eq!(seen.recv(), Ok(3));
            begins_none();
            Ok(())
        };
        ahead((0..100, waiting(3)), assemblers.collect(), work).unwrap();
    }

    #[test]
    fn the_error_of_a_thread_comes_after_the_batches_before_it() {
        let assemble = |number| {
            assert_ne!(number, 4, "batch {number} cannot be assembled");
            Ok(number)
        };
        let mut done = Vec::new();
        let failed = ahead((0..u64::MAX, waiting(3)), vec![assemble; 3], |next| -> Result<(), _> {
            loop {
                done.push(next()?.batch);
            }
        });
        assert!(failed.unwrap_err().to_string().ends_with("batch 4 cannot be assembled"));
        assert_eq!(done, [0, 1, 2, 3]);
    }
}
