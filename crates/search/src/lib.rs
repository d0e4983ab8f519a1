//! Exact nearest neighbours of points in three parts, on the CPU.
//!
//! - [`Points`] are N rows, or windows of rows, of single-precision values in [`PARTS`] parts of fixed widths.
//! - [`Index`] holds groups of points and returns, for each query, the [`Match`] with the smallest distance under a
//!   [`Metric`]: bit for bit that of a comparison with every point in double precision, for any tiles, threads and processor.
//! - [`Neighbours`] returns the k nearest points of other groups in single precision, for means and other statistics.
//!
//! No tensor appears in the interface, and the crate depends on no other crate of the workspace. The tensor library panics
//! if it runs out of memory, so callers that must survive catch the unwind.
//!
//! ```no_run,standalone_crate
//! use gleaner_search::{Distance, Index, Metric, Points};
//!
//! let point = |x: f32| Points::new([vec![x], vec![0.0], vec![0.0]], [1, 1, 1]);
//! let (near, far) = (point(1.0)?, point(9.0)?);
//! let metric = Metric { kind: Distance::Euclidean, scale: [1.0; 3] };
//! let index = Index::new(&[(0, &near), (1, &far)], metric)?;
//! let matches = index.nearest(&point(2.0)?, None)?.expect("there are points");
//! assert_eq!(matches[0].group, 0);
//! # Ok::<(), gleaner_search::SearchError>(())
//! ```

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
mod slide;
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
pub use points::{PARTS, PointShape, Points};
