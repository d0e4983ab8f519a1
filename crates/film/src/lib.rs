//! Pictures of one size as a video: AV1 in an MP4 file, at a constant rate, with one packet for each picture in its order.
//!
//! A [`FilmWriter`] takes pictures and writes packets as they come, so that memory follows one picture. The same pictures
//! give the same bytes. The crate depends on no other crate of the workspace and does not depend on recordings or datasets.

mod container;
mod encoder;
mod error;
mod planes;
mod size;
mod writer;

pub use error::FilmError;
pub use size::Size;
pub use writer::FilmWriter;
