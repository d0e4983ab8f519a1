//! The gRPC services of gleaner, generated from `gleaner/v1/*.proto` and `inference/*.proto` without protoc.
//!
//! The crate has wire types only, without conversions or rules. Clients and the server link it; the feature `services` adds
//! the clients and the server traits, and with them tonic.
//!
//! [`v1`] has the services of gleaner; [`inference`] has the Open Inference Protocol; [`Rpc`] names every rpc, and
//! [`DESCRIPTORS`] describes them for reflection.

/// `gleaner.v1`: the messages, clients and server traits.
pub mod v1 {
    #![allow(missing_docs, clippy::all, clippy::pedantic, unreachable_pub, reason = "generated code")]
    include!(concat!(env!("OUT_DIR"), "/gleaner.v1.rs"));
}

/// `inference`: the Open Inference Protocol, which clients of other inference servers use.
pub mod inference {
    #![allow(missing_docs, clippy::all, clippy::pedantic, unreachable_pub, reason = "generated code")]
    include!(concat!(env!("OUT_DIR"), "/inference.rs"));
}

/// The encoded `FileDescriptorSet` of every service here, for server reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

mod rpc {
    #![allow(clippy::all, clippy::pedantic, reason = "generated code")]
    include!(concat!(env!("OUT_DIR"), "/rpcs.rs"));
}

pub use rpc::Rpc;
