//! Exact nearest neighbours of points in three parts, on the CPU.
//!
//! [`Points`] are N rows of single-precision values in [`PARTS`] parts of fixed widths. An [`Index`] holds groups of
//! points and returns, per query, the [`Match`] with the smallest distance under a [`Metric`]: bit for bit that of a
//! comparison with every point in double precision, whatever the tiles, the threads or the processor. [`Neighbours`]
//! returns the k nearest points of other groups in single precision, for means and other statistics.
//!
//! Tensors stay inside; no other crate of the workspace is named here. The tensor library panics when memory runs out,
//! so a caller that must survive this catches the unwind.

mod bound;
mod codes;
mod corpus;
mod directions;
mod error;
mod index;
mod lanes;
mod level;
mod matched;
mod metric;
mod neighbours;
mod points;
mod scan;
mod sweep;
mod tensor;
#[cfg(test)]
mod testing;
mod threads;

pub use error::SearchError;
pub use index::Index;
pub use matched::Match;
pub use metric::{Distance, Metric};
pub use neighbours::Neighbours;
pub use points::{PARTS, Points};
