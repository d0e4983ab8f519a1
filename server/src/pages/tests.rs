//! The pages on a real store, requested without a socket.

mod access;
mod artifacts;
mod audit;
mod deployments;
mod episode;
mod episodes;
mod jobs;
mod kinds;
mod overview;
mod runs;
