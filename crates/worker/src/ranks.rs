//! The ranks of an attempt with several processes: they find each other by the server, and each becomes a member of the
//! group that shares the work. Independent of the kind of job.

use std::{
    io,
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs as _, UdpSocket},
    time::Duration,
};

use gleaner_core::{
    Device,
    error::{Error, Result},
    id::JobId,
    order::JobOrder,
};
use gleaner_group::{Meeting, Place};
use gleaner_learn::Peers;
use tonic::transport::Uri;

use crate::{client::Client, config::WorkerConfig, failure::Failure};

/// This process's way into its group; joining waits for the others.
pub(crate) enum Ranks {
    /// There are no others.
    Alone,
    /// Rank 0 waits at a port of its own.
    Opened(Place, Meeting, String),
    /// Rank 0 waits at this address.
    Found(Place, SocketAddr, String, Duration),
}

impl Ranks {
    /// Reports where rank 0 waits, or asks for it.
    ///
    /// # Errors
    /// Invalid for a rank outside the group; Unavailable when rank 0 does not report.
    pub(crate) async fn meet(
        config: &WorkerConfig,
        client: &mut Client,
        job: &JobId,
        order: &JobOrder,
    ) -> Result<Self> {
        let WorkerConfig { rank, ranks, .. } = *config;
        if ranks < 2 {
            return Ok(Self::Alone);
        }
        if rank >= ranks {
            return Err(Error::invalid("--rank", format!("is {rank}, must be below --ranks {ranks}")));
        }
        let timeout = Duration::from_secs(config.rank_timeout_seconds);
        let place = Place { rank, ranks, address: own_address(&config.server)?, gpu: on_gpu(order) };
        let name = job.to_string();
        if rank > 0 {
            return Ok(Self::Found(place, client.meeting(timeout).await?, name, timeout));
        }
        let opened = Meeting::open(ranks, timeout);
        let meeting = opened.map_err(|error| Error::internal("opening a port for the other ranks", error))?;
        client.report_meeting(SocketAddr::new(place.address, meeting.port())).await?;
        Ok(Self::Opened(place, meeting, name))
    }

    /// Whether this process reports, stores checkpoints and completes the job.
    pub(crate) fn lead(&self) -> bool {
        matches!(self, Self::Alone | Self::Opened(..))
    }

    /// Waits until all have joined.
    ///
    /// # Errors
    /// When one is missing after the timeout.
    pub(crate) fn join(self) -> std::result::Result<Peers, Failure> {
        let (place, meeting, name) = match self {
            Self::Alone => return Ok(Peers::alone()),
            Self::Opened(place, meeting, name) => (place, meeting, name),
            Self::Found(place, address, name, timeout) => (place, Meeting::find(address, place.ranks, timeout)?, name),
        };
        let group = meeting.join(&name, place)?;
        tracing::info!(rank = place.rank, ranks = place.ranks, "joined");
        Ok(Peers::of(group))
    }
}

fn on_gpu(order: &JobOrder) -> bool {
    match order {
        JobOrder::Pretrain { spec, .. } => spec.run.device == Device::Cuda,
        JobOrder::Train { spec, .. } => spec.run.device == Device::Cuda,
        // Scores and results of attempts are exchanged in main memory.
        JobOrder::Score { .. } | JobOrder::Evaluate { .. } | JobOrder::Export { .. } => false,
    }
}

/// The address of this machine on the way to the server. Nothing is sent.
fn own_address(server: &str) -> Result<IpAddr> {
    let uri: Uri = server.parse().map_err(|error| Error::invalid("--server", error))?;
    let host = uri.host().ok_or_else(|| Error::invalid("--server", "names no host"))?;
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let port = uri.port_u16().unwrap_or(443);
    let found = (host, port).to_socket_addrs().and_then(|addresses| own_address_towards(addresses.collect()));
    found.map_err(|error| Error::internal("finding the address of this machine", error))
}

/// The address of this machine on the way to one of these addresses. IPv4 comes first, because all ranks need the same
/// protocol; a name may have no address of it.
fn own_address_towards(mut addresses: Vec<SocketAddr>) -> io::Result<IpAddr> {
    addresses.sort_by_key(SocketAddr::is_ipv6);
    let mut last = io::Error::from(io::ErrorKind::AddrNotAvailable);
    for address in addresses {
        let any: IpAddr = if address.is_ipv6() { Ipv6Addr::UNSPECIFIED.into() } else { Ipv4Addr::UNSPECIFIED.into() };
        let found = UdpSocket::bind((any, 0)).and_then(|socket| {
            socket.connect(address)?;
            socket.local_addr()
        });
        match found {
            Ok(own) => return Ok(own.ip()),
            Err(error) => last = error,
        }
    }
    Err(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_address_for_other_ranks_is_that_of_the_way_to_the_server() {
        assert_eq!(own_address("http://127.0.0.1:7402").unwrap().to_string(), "127.0.0.1");
        assert_eq!(own_address("https://[::1]:7402").unwrap().to_string(), "::1");
        let of_a_name = |addresses: &[&str]| {
            own_address_towards(addresses.iter().map(|address| address.parse().unwrap()).collect())
        };
        assert_eq!(of_a_name(&["[::1]:7402"]).unwrap().to_string(), "::1", "a name without IPv4");
        assert_eq!(of_a_name(&["[::1]:7402", "127.0.0.1:7402"]).unwrap().to_string(), "127.0.0.1");
        assert!(of_a_name(&[]).is_err());
        for wrong in ["", "/nowhere", "not a url"] {
            assert!(own_address(wrong).unwrap_err().to_string().starts_with("--server: "), "{wrong}");
        }
    }
}
