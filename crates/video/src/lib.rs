//! Video: from the messages of one camera to pictures.
//!
//! A stream is a sequence of messages, each with the bytes of one picture in decoding order: H.264 or H.265 as Annex B,
//! AV1 as a temporal unit. [`glance`] returns what a message holds without decoding it; a [`Stream`] decodes the messages
//! and returns one [`Outcome`] for each message with a picture.
//!
//! The bytes are untrusted. A picture of another size than expected is rejected before memory is reserved for it, damage
//! is an error and never a panic of this crate, and the same messages always have the same outcomes. The crate depends on
//! no other crate of the workspace and does not depend on recordings, topics or tasks.

mod annex_b;
mod av1;
mod codec;
mod decoder;
mod error;
mod glance;
mod h264;
mod h265;
mod picture;
mod stream;

pub use codec::{Codec, Format};
pub use error::VideoError;
pub use glance::{Glance, Part};
pub use picture::{Color, Matrix, Picture, Plane};
pub use stream::{Outcome, Stream, glance};

#[cfg(test)]
mod tests;
