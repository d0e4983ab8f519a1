//! The gRPC services of gleaner, generated without protoc.
