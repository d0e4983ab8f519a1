//! The device of tensors and the number of threads. The only module of this crate that changes process-wide settings of the
//! tensor library; `gleaner_search` sets the number of threads while it searches.

use std::hint::black_box;
use std::io;
use std::sync::mpsc::channel;
use std::sync::{Mutex, Once, PoisonError};
use std::thread::{Builder, Scope};

use tch::Tensor;

use crate::error::LearnError;
use gleaner_core::{Device, Precision};
use gleaner_group::allow_tf32;

/// The number of intra-op threads of the process, once it is known. Held while the number changes.
static THREADS: Mutex<Option<i32>> = Mutex::new(None);

/// Just under the largest value of glibc's dynamic threshold.
const KEPT: usize = (32 << 20) - (64 << 10);

/// Sets the number of intra-op threads of the whole process (at least 1).
///
/// Serve with one thread per model: a second thread on busy cores costs more than it gains.
pub fn set_threads(threads: u32) {
    let mut process = THREADS.lock().unwrap_or_else(PoisonError::into_inner);
    tch::set_num_threads(*process.insert(i32::try_from(threads.max(1)).unwrap_or(i32::MAX)));
}

/// The library's device for `device`; also sets `threads`, if given.
pub(crate) fn open(device: Device, threads: Option<u32>) -> Result<tch::Device, LearnError> {
    if let Some(threads) = threads {
        set_threads(threads);
    }
    keep_memory();
    match device {
        Device::Cpu => Ok(tch::Device::Cpu),
        Device::Cuda if tch::Cuda::is_available() => {
            // f32 is f32 in convolutions too.
            allow_tf32(false)?;
            Ok(tch::Device::Cuda(0))
        }
        Device::Cuda => Err(LearnError::invalid("device", "is cuda, but no CUDA device is usable here; use cpu")),
    }
}

/// The number of threads that assemble batches for work on `device`: one beside the threads of the tensor library, and all
/// of these on a GPU, where they have nothing else to do.
pub(crate) fn assembling_threads(device: tch::Device) -> usize {
    if !device.is_cuda() {
        return 1;
    }
    let mut process = THREADS.lock().unwrap_or_else(PoisonError::into_inner);
    usize::try_from(*process.get_or_insert_with(tch::get_num_threads)).unwrap_or(1).max(1)
}

/// TF32 on GPUs, allowed until it is dropped. A switch of the whole process, whose worker has one training.
pub(crate) struct Tf32(());

impl Tf32 {
    /// Allows it for a precision of TF32; `None` for others.
    pub(crate) fn of(precision: Precision) -> Result<Option<Self>, LearnError> {
        if precision != Precision::Tf32 {
            return Ok(None);
        }
        allow_tf32(true)?;
        Ok(Some(Self(())))
    }
}

impl Drop for Tf32 {
    fn drop(&mut self) {
        // A switch that was set once can be set again.
        let _forbidden = allow_tf32(false);
    }
}

/// Starts a thread in `scope` whose tensor operations run on that thread alone, whatever the number of intra-op threads
/// of the process.
///
/// # Errors
/// The system's, if it starts no further thread.
pub(crate) fn spawn_single<'scope>(
    scope: &'scope Scope<'scope, '_>,
    work: impl FnOnce() + Send + 'scope,
) -> io::Result<()> {
    let mut process = THREADS.lock().unwrap_or_else(PoisonError::into_inner);
    let threads = *process.get_or_insert_with(tch::get_num_threads);
    let (started, wait) = channel::<()>();
    // The number becomes that of the thread which sets it, and of all that start later. So another thread returns it to
    // the process: the caller, which may itself be a single thread, keeps its own.
    let restore = move || {
        let _ended = wait.recv();
        tch::set_num_threads(threads);
    };
    let restored = Builder::new().spawn_scoped(scope, restore)?;
    let single = move || {
        // The first call on a thread takes the number of the process, so it comes before that of the thread.
        let _process = tch::get_num_threads();
        tch::set_num_threads(1);
        drop(started);
        work();
    };
    Builder::new().name("batches".to_owned()).spawn_scoped(scope, single)?;
    let _ended = restored.join();
    Ok(())
}

/// A `tensor` in main memory, sent to `device`. To CUDA it is copied from page-locked memory without waiting for the
/// device; the library keeps that memory until the copy is complete, and later operations wait for the copy.
pub(crate) fn send(tensor: &Tensor, device: tch::Device) -> Tensor {
    if !device.is_cuda() {
        return tensor.to_device(device);
    }
    tensor.pin_memory(device).to_device_(device, tensor.kind(), true, false)
}

/// Makes the C library retain freed memory for the next tensor, up to twice [`KEPT`] for each thread's heap.
///
/// By default glibc returns the memory of tensors to the system as soon as they are freed, and requests it again, page
/// by page, in the next pass: half of the time of a pass over the images of sixteen sessions. Freeing one large piece
/// raises glibc's threshold (`mallopt(3)`, M_MMAP_THRESHOLD) for such pieces. No page of this piece is touched; other C
/// libraries are not affected.
fn keep_memory() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| drop(black_box(Vec::<u8>::with_capacity(KEPT))));
}

#[cfg(all(test, target_os = "linux", target_env = "gnu"))]
mod tests {
    #![allow(clippy::unwrap_used, reason = "clippy sees a test module only under a plain cfg(test)")]
    use super::*;
    use crate::own_process::in_own_process;

    const PIECE: usize = 16 << 20;

    #[test]
    fn a_single_thread_that_starts_another_stays_single_and_the_process_keeps_its_number() {
        let (number, numbers) = channel();
        std::thread::scope(|scope| {
            let first = move || {
                std::thread::scope(|inner| spawn_single(inner, || ()).unwrap());
                number.send(tch::get_num_threads()).unwrap();
            };
            spawn_single(scope, first).unwrap();
        });
        // Held, so that no other test changes the number.
        let process = THREADS.lock().unwrap();
        let later = std::thread::spawn(tch::get_num_threads).join().unwrap();
        assert_eq!((numbers.recv().unwrap(), later), (1, process.unwrap()));
    }

    /// Pages given to this thread so far.
    fn faults() -> usize {
        let stat = std::fs::read_to_string("/proc/thread-self/stat").unwrap();
        // The name may contain any character. After it come the state, seven more fields, and the faults.
        stat.rsplit_once(')').unwrap().1.split_whitespace().nth(7).unwrap().parse().unwrap()
    }

    #[test]
    fn all_threads_assemble_for_a_gpu_and_one_for_processors() {
        if !in_own_process() {
            return;
        }
        let own = usize::try_from(tch::get_num_threads()).unwrap();
        assert_eq!(assembling_threads(tch::Device::Cuda(0)), own);
        set_threads(3);
        assert_eq!(assembling_threads(tch::Device::Cuda(0)), 3);
        assert_eq!(assembling_threads(tch::Device::Cpu), 1);
    }

    #[test]
    fn memory_that_is_freed_is_there_for_the_next() {
        // A thread takes over the heap of one that ended, with all that is left in it.
        if !in_own_process() {
            return;
        }
        // A separate thread, as for a model; it begins with an empty heap.
        let again = std::thread::spawn(|| {
            open(Device::Cpu, None).unwrap();
            drop(black_box(vec![1u8; PIECE]));
            let before = faults();
            for _ in 0..8 {
                drop(black_box(vec![1u8; PIECE]));
            }
            faults() - before
        });
        let again = again.join().unwrap();
        assert!(again < PIECE / 4096 / 8, "{again} pages for eight times {} pages", PIECE / 4096);
    }
}
