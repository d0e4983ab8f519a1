//! Permits for connections: a maximum in all and one for each peer key. Must not depend on the content of connections.

use std::{
    collections::{HashMap, hash_map::Entry},
    net::{IpAddr, Ipv6Addr},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

/// The permits of a listener; clones share them.
#[derive(Clone)]
pub(crate) struct Permits(Arc<Inner>);

struct Inner {
    most: usize,
    most_of_one: usize,
    taken: Mutex<Taken>,
}

#[derive(Default)]
struct Taken {
    all: usize,
    by_address: HashMap<IpAddr, usize>,
}

/// A permit, held until this is dropped.
pub(crate) struct Permit {
    permits: Permits,
    address: IpAddr,
}

/// The limit that is reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Full {
    All,
    Address,
}

impl Permits {
    pub(crate) fn new(most: usize, most_of_one: usize) -> Self {
        Self(Arc::new(Inner { most, most_of_one, taken: Mutex::default() }))
    }

    /// Takes a permit for a peer.
    ///
    /// # Errors
    /// The limit that is reached.
    pub(crate) fn take(&self, peer: IpAddr) -> Result<Permit, Full> {
        let address = peer_key(peer);
        let mut taken = self.taken();
        if taken.all >= self.0.most {
            return Err(Full::All);
        }
        let of_one = taken.by_address.entry(address).or_default();
        if *of_one >= self.0.most_of_one {
            return Err(Full::Address);
        }
        *of_one += 1;
        taken.all += 1;
        metrics::gauge!("gleaner_connections").increment(1.0);
        Ok(Permit { permits: self.clone(), address })
    }

    fn taken(&self) -> MutexGuard<'_, Taken> {
        self.0.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut taken = self.permits.taken();
        taken.all = taken.all.saturating_sub(1);
        if let Entry::Occupied(mut of_one) = taken.by_address.entry(self.address) {
            *of_one.get_mut() -= 1;
            if *of_one.get() == 0 {
                of_one.remove();
            }
        }
        metrics::gauge!("gleaner_connections").decrement(1.0);
    }
}

/// The key of one peer: its IPv4 address, or the /64 that an IPv6 host may choose its addresses from.
pub(crate) fn peer_key(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V4(v4) => IpAddr::V4(v4),
        IpAddr::V6(v6) if v6.is_loopback() => IpAddr::V6(v6),
        IpAddr::V6(v6) => IpAddr::V6(Ipv6Addr::from_bits(v6.to_bits() & !u128::from(u64::MAX))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(permits: &Permits, address: &str) -> Result<Permit, Full> {
        permits.take(address.parse().unwrap())
    }

    #[test]
    fn one_address_cannot_take_all_permits_and_returned_ones_are_free() {
        let permits = Permits::new(3, 2);
        let first = take(&permits, "10.0.0.1").unwrap();
        let _second = take(&permits, "::ffff:10.0.0.1").unwrap();
        assert_eq!(take(&permits, "10.0.0.1").err(), Some(Full::Address));
        let _third = take(&permits, "10.0.0.2").unwrap();
        assert_eq!(take(&permits, "10.0.0.3").err(), Some(Full::All));
        drop(first);
        let _fourth = take(&permits, "10.0.0.1").unwrap();
        assert_eq!(permits.taken().by_address.len(), 2);
    }

    #[test]
    fn a_host_with_many_ipv6_addresses_is_one_peer() {
        let permits = Permits::new(9, 1);
        let _one = take(&permits, "2001:db8::1").unwrap();
        assert_eq!(take(&permits, "2001:db8::2").err(), Some(Full::Address));
        take(&permits, "2001:db8:0:1::1").unwrap();
        take(&permits, "::1").unwrap();
    }
}
