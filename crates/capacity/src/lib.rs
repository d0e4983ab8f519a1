//! What a lab of a size needs of one server and of what stands beside it: recordings, disk, inspection, scoring, sessions
//! and memory, each from a rate that was measured, and the part that gives out first. The crate computes and prints; it
//! depends on no other crate of the workspace and reads nothing.

mod camera;
mod codec;
mod demand;
mod lab;
mod limit;
mod machine;
mod rate;
mod report;

pub use camera::Camera;
pub use codec::Codec;
pub use demand::{Demand, Part};
pub use lab::Lab;
pub use limit::largest_lab;
pub use machine::Machine;
pub use report::{Report, report};
