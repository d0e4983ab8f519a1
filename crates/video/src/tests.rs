//! Tests of the whole crate on the streams in `fixtures/`, which FFmpeg's encoders made and FFmpeg decoded.

mod damage;
mod exact;
mod fixture;
mod joins;
