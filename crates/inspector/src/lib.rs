//! Inspection of one untrusted recording: the process limits itself, reads the file, and writes a verdict and the decoded
//! frames.
//!
//! The server starts the program `gleaner-inspector` for each recording, because damaged files can abort the process that
//! reads them; `gleaner` starts it for recordings that are not sent, and to convert datasets of other programs. The crate
//! depends on `gleaner-recording` and `gleaner-formats` only, so that the process starts in milliseconds. Both link the library for [`Order`] (the arguments), [`Verdict`] (the result) and [`RecordingsConfig`] (the limits as flags).

mod error;
mod inspect;
mod limits;
mod order;
mod recordings;

pub use error::InspectError;
pub use gleaner_formats::import::{Assumed, Converted, Description, FieldOrigin, LeftOut, run_file};
pub use inspect::{Described, Verdict, inspect};
pub use limits::apply as apply_limits;
pub use order::{Order, most_written};
pub use recordings::RecordingsConfig;
