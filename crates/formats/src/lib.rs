//! Datasets as files that other programs read: steps in, files out; and datasets of other programs: files in, steps out.
//!
//! [`import`] is the way in from other programs, and [`write()`] the way out to them. An [`Export`] has the pieces of a dataset (experts whole, each kept stretch of an imperfect
//! episode), reads their steps, and takes each finished file. A format is one file here, or a folder, and a line in
//! [`write()`]. It must not depend on servers, jobs or learning. The same pieces give the same bytes.

mod export;
pub mod import;
mod lerobot;
mod mcap_files;
mod piece;
mod problem;
mod robomimic;
#[cfg(test)]
mod testing;

use gleaner_core::dataset::{ExportFormat, ExportSpec};

pub use export::{Export, Numbers};
pub use piece::{Piece, pieces};
pub use problem::Problem;

/// Writes the files of an export.
///
/// # Errors
/// [`Problem`] of the format, and every error of `export`. Files that were taken before the error are of no use.
pub fn write<E: Export>(spec: ExportSpec, export: &mut E) -> Result<(), E::Error> {
    match spec.format {
        ExportFormat::Mcap => mcap_files::write(export),
        ExportFormat::Lerobot => lerobot::write(export, spec),
        ExportFormat::Robomimic => robomimic::write(export, spec.depth),
    }
}
