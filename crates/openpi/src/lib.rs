//! Messages of openpi's policy protocol: a task's observations out of a client's maps, and replies with actions.
//!
//! openpi's clients (DROID, ALOHA, LIBERO) send msgpack maps of numpy arrays over a WebSocket, with keys of their own, and
//! read a map with `actions`. [`request`] finds the cameras and values of a task in such a map; [`metadata`] and [`reply`]
//! write what the clients read. [`observation`] and [`actions`] are the other side, for a server of openpi. Depends on the
//! values of `gleaner-core` alone; must not know sockets, sessions or policies.

mod array;
mod client;
mod named;
mod reply;
mod request;

pub use client::{Value, actions, observation, server_metadata};
pub use reply::{Metadata, Reply, metadata, reply};
pub use request::{Request, largest_request, request};
