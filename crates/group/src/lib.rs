//! What libtorch contains and tch does not bind: sums over the processes of one job, by its process groups (gloo, and
//! NCCL in a CUDA build), and its switch of TF32. Independent of models, jobs and servers.
//!
//! Rank 0 opens a [`Meeting`] at a free port; the others connect to it. Each then becomes a [`Group`], which returns when
//! all have joined. Every rank calls the same operations in the same order. Every rank gets the same bits, and the same
//! bits in every run with the same number of ranks.
//!
//! Neither the meeting nor the group has encryption or a password, and a meeting listens on every interface: they are for
//! one machine or a cluster's own network only.
//!
//! ```no_run,standalone_crate
//! use std::time::Duration;
//! use gleaner_group::{Meeting, Place};
//!
//! # fn rank_1(mut tensor: tch::Tensor) -> Result<(), gleaner_group::GroupError> {
//! let timeout = Duration::from_secs(60);
//! let place = Place { rank: 1, ranks: 2, address: "10.0.0.6".parse().unwrap(), gpu: false };
//! let mut group = Meeting::find("10.0.0.5:41234".parse().unwrap(), 2, timeout)?.join("job", place)?;
//! group.sum(&mut tensor)?;
//! # Ok(())
//! # }
//! ```

mod bindings;
mod error;
mod tf32;

use std::{
    net::{IpAddr, SocketAddr},
    time::Duration,
};

use tch::Tensor;

use bindings::{Joined, Store};
pub use error::GroupError;
pub use tf32::{allow_tf32, tf32_allowed};

/// Most attempts of the ranks to connect to each other.
const ATTEMPTS: u32 = 3;
/// The part of gloo's message when all ranks came and their connections failed.
const UNCONNECTED: &str = "connectFullMesh failed";
/// What a rank writes about its connections.
const YES: &str = "yes";
const NO: &str = "no";

/// Where the ranks of a group find each other.
pub struct Meeting {
    store: Store,
    port: u16,
    ranks: u32,
    timeout: Duration,
}

/// The place of a process in a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Its number, from 0.
    pub rank: u32,
    /// The number of processes.
    pub ranks: u32,
    /// The address at which the other ranks reach this process.
    pub address: IpAddr,
    /// Whether the tensors are on a GPU. They are summed there by NCCL if the build has it, and else by way of main
    /// memory.
    pub gpu: bool,
}

impl Meeting {
    /// Opens the meeting of `ranks` processes at a free port of every interface, as rank 0. `timeout` limits joining and
    /// each later operation.
    ///
    /// # Errors
    /// [`GroupError::Meeting`] when no port can be opened.
    pub fn open(ranks: u32, timeout: Duration) -> Result<Self, GroupError> {
        let opened = Store::open("localhost", 0, true, ranks, timeout);
        let (store, port) = opened.map_err(|message| GroupError::Meeting { message })?;
        Ok(Self { store, port, ranks, timeout })
    }

    /// Finds the meeting that rank 0 opened at `address`.
    ///
    /// # Errors
    /// [`GroupError::Meeting`] when it does not answer within about two and a half times `timeout`.
    pub fn find(address: SocketAddr, ranks: u32, timeout: Duration) -> Result<Self, GroupError> {
        let opened = Store::open(&address.ip().to_string(), address.port(), false, ranks, timeout);
        let (store, port) =
            opened.map_err(|message| GroupError::Meeting { message: format!("rank 0 at {address}: {message}") })?;
        Ok(Self { store, port, ranks, timeout })
    }

    /// The port of the meeting.
    #[must_use]
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Joins the group of this name, which all its ranks share, and returns when all have joined.
    ///
    /// Of many groups that three or more ranks of busy machines join, gloo loses a connection of some: the ranks then
    /// try again together, under another name.
    ///
    /// # Errors
    /// [`GroupError::Place`] for a place outside the group, [`GroupError::Join`] when another rank is missing after the
    /// timeout.
    pub fn join(self, name: &str, place: Place) -> Result<Group, GroupError> {
        let Place { rank, ranks, address, gpu } = place;
        if ranks != self.ranks || rank >= ranks {
            return Err(GroupError::Place { rank, ranks });
        }
        let (gpu, address) = (gpu && bindings::has_nccl(), address.to_string());
        let failed = |message: String| GroupError::of_join(rank, ranks, self.timeout, &message);
        let mut last = String::new();
        for attempt in 0..ATTEMPTS {
            let name = format!("{name}/{attempt}");
            let own = bindings::Place { name: &name, rank, ranks, address: &address, gpu };
            let joined = match Joined::new(&self.store, &own, self.timeout) {
                Err(message) if !message.contains(UNCONNECTED) => return Err(failed(message)),
                joined => joined,
            };
            if self.all_connected(&name, rank, joined.is_ok()).map_err(failed)? {
                let joined = joined.map_err(failed)?;
                return Ok(Group { joined, _store: self.store, rank, ranks, timeout: self.timeout, broken: None });
            }
            last = joined.err().unwrap_or_else(|| "another rank could not connect".to_owned());
        }
        Err(failed(last))
    }

    /// Whether every rank connected to all others, as each writes into the store.
    fn all_connected(&self, name: &str, rank: u32, own: bool) -> Result<bool, String> {
        let key = |what: &str, rank: u32| format!("{name}/{what}/{rank}");
        self.store.set(&key("connected", rank), if own { YES } else { NO })?;
        let mut all = true;
        for rank in 0..self.ranks {
            all &= self.store.compare(&key("connected", rank), YES, self.timeout)?;
        }
        self.store.set(&key("read", rank), YES)?;
        // Rank 0 serves the store, and may close it once all have read it.
        let readers = if rank == 0 { self.ranks } else { 0 };
        for rank in 0..readers {
            self.store.compare(&key("read", rank), YES, self.timeout)?;
        }
        Ok(all)
    }
}

/// A group that this process has joined.
pub struct Group {
    joined: Joined,
    /// NCCL connects at the first operation, by the store. It is closed after the group.
    _store: Store,
    rank: u32,
    ranks: u32,
    timeout: Duration,
    /// The first failure, which ends the group.
    broken: Option<GroupError>,
}

impl Group {
    /// The number of this process, from 0.
    #[must_use]
    pub fn rank(&self) -> u32 {
        self.rank
    }

    /// The number of processes.
    #[must_use]
    pub fn ranks(&self) -> u32 {
        self.ranks
    }

    /// Makes `tensor` the sum of the ranks' tensors, of one size and kind.
    ///
    /// # Errors
    /// [`GroupError::Gone`] at once when another rank has ended, [`GroupError::Silent`] when one does not answer within
    /// the timeout. The group then has ended: every later operation returns the same error.
    pub fn sum(&mut self, tensor: &mut Tensor) -> Result<(), GroupError> {
        self.with(tensor, Joined::sum)
    }

    /// Makes `tensor` that of rank 0; the ranks' tensors are of one size and kind.
    ///
    /// # Errors
    /// As [`Group::sum`].
    pub fn broadcast(&mut self, tensor: &mut Tensor) -> Result<(), GroupError> {
        self.with(tensor, Joined::broadcast)
    }

    fn with(
        &mut self,
        tensor: &mut Tensor,
        act: impl Fn(&Joined, &mut Tensor) -> Result<(), String>,
    ) -> Result<(), GroupError> {
        if let Some(error) = &self.broken {
            return Err(error.clone());
        }
        let done = if tensor.is_contiguous() {
            act(&self.joined, tensor)
        } else {
            let mut copy = tensor.contiguous();
            act(&self.joined, &mut copy).map(|()| tensor.copy_(&copy))
        };
        done.map_err(|message| {
            let error = GroupError::of_operation(self.rank, self.ranks, self.timeout, &message);
            self.broken = Some(error.clone());
            error
        })
    }
}

impl std::fmt::Debug for Group {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Group").field("rank", &self.rank).field("ranks", &self.ranks).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use std::{net::Ipv4Addr, thread};

    use super::*;

    #[test]
    fn ranks_try_again_together_when_one_lost_a_connection() {
        const LOCAL: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
        let timeout = Duration::from_secs(20);
        let meeting = Meeting::open(2, timeout).unwrap();
        let at = SocketAddr::new(LOCAL, meeting.port());
        // Reports a lost connection at the first attempt.
        let other = thread::spawn(move || {
            let meeting = Meeting::find(at, 2, timeout).unwrap();
            let joined = |attempt: u32, connected: bool| {
                let name = format!("test/{attempt}");
                let own = bindings::Place { name: &name, rank: 1, ranks: 2, address: "127.0.0.1", gpu: false };
                let joined = Joined::new(&meeting.store, &own, timeout).unwrap();
                assert_eq!(meeting.all_connected(&name, 1, connected).unwrap(), connected);
                joined
            };
            drop(joined(0, false));
            let mut tensor = Tensor::from_slice(&[2f32]);
            joined(1, true).sum(&mut tensor).unwrap();
            tensor.double_value(&[0])
        });
        let mut group = meeting.join("test", Place { rank: 0, ranks: 2, address: LOCAL, gpu: false }).unwrap();
        let mut tensor = Tensor::from_slice(&[1f32]);
        group.sum(&mut tensor).unwrap();
        assert_eq!((tensor.double_value(&[0]), other.join().unwrap()), (3.0, 3.0));
    }
}
