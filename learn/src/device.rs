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
