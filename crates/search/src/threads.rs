//! Work on several threads, each with one thread of the tensor library. Must not depend on the content of the work.

/// Threads that the tensor library would use.
pub(crate) fn available() -> usize {
    usize::try_from(tch::get_num_threads()).unwrap_or(1)
}

/// Runs `work` for each of `workers` on a thread of its own with one intra-op thread, and waits for all; a single
/// worker stays on this thread. A panic in one of them is resumed on this thread.
pub(crate) fn side_by_side<W: Send>(mut workers: Vec<W>, work: impl Fn(W) + Sync) {
    if workers.len() < 2 {
        return workers.pop().map_or((), work);
    }
    // The setting applies to every thread that the process starts from then on, so it is restored at the end.
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
