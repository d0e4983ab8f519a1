//! Where tensors live and how many threads work on them. The only room that touches
//! process-wide settings of the tensor library.

use crate::error::LearnError;
use crate::spec::Device;

/// Sets the number of intra-op threads of the whole process (at least 1).
///
/// Serve with one thread per model: two threads on busy cores cost more than they give.
pub fn set_threads(threads: u32) {
    tch::set_num_threads(i32::try_from(threads.max(1)).unwrap_or(i32::MAX));
}

/// The library's device for `device`, after setting `threads` if asked.
pub(crate) fn open(device: Device, threads: Option<u32>) -> Result<tch::Device, LearnError> {
    if let Some(threads) = threads {
        set_threads(threads);
    }
    match device {
        Device::Cpu => Ok(tch::Device::Cpu),
        Device::Cuda if tch::Cuda::is_available() => Ok(tch::Device::Cuda(0)),
        Device::Cuda => Err(LearnError::invalid("device", "is cuda, but no CUDA device is usable here; use cpu")),
    }
}

/// Runs `work` for each of `workers` on a thread of its own with one intra-op thread, and waits
/// for all; a single worker stays on this thread. What one of them panics with, this panics with.
pub(crate) fn side_by_side<W: Send>(mut workers: Vec<W>, work: impl Fn(W) + Sync) {
    if workers.len() < 2 {
        return workers.pop().map_or((), work);
    }
    // The setting is the process's for threads yet to begin; dropped, it is as it was.
    let _restore = Threads(tch::get_num_threads());
    let work = &work;
    std::thread::scope(|scope| {
        let run = |worker| {
            scope.spawn(move || {
                tch::set_num_threads(1);
                work(worker);
            })
        };
        let running: Vec<_> = workers.into_iter().map(run).collect();
        for thread in running {
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        }
    });
}

struct Threads(i32);

impl Drop for Threads {
    fn drop(&mut self) {
        tch::set_num_threads(self.0);
    }
}
