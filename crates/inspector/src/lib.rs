//! Reads one recording that may be hostile: takes limits on itself, reads, writes the verdict and the frames.
//!
//! The program beside this library is what the server starts for each recording. It links nothing of learning or serving,
//! because a process that lives for one recording must start in milliseconds. Knows no server, database or job.

mod error;
mod inspect;
mod limits;
mod order;
mod recordings;

pub use error::InspectError;
pub use inspect::{Verdict, inspect};
pub use limits::take as take_limits;
pub use order::Order;
pub use recordings::RecordingsConfig;
