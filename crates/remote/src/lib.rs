//! Calls of policies that other servers run, by the Open Inference Protocol or by openpi's.
//!
//! A [`Remote`] is one registered policy with its server; an [`Episode`] is one session with it. What the server answers is
//! untrusted: its size, form and values are checked, and a call has limits on its time. [`Outgoing`] has the operator's
//! rules: which hosts may be called, with which tokens and authorities. Must not know tensors, rows, sessions of this
//! server or how chunks are executed.

mod actions;
mod address;
mod backoff;
mod fault;
mod inputs;
mod open_inference;
mod openpi;
mod outgoing;
mod remote;

pub use inputs::Step;
pub use outgoing::{Hosts, Outgoing};
pub use remote::{Episode, Remote};
