//! Places for connections: so many in all, so many for one address.

use std::{
    collections::{HashMap, hash_map::Entry},
    net::{IpAddr, Ipv6Addr},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

/// Places; clones share them.
#[derive(Clone)]
pub(super) struct Places(Arc<Inner>);

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

/// A place that is taken until this is dropped.
pub(super) struct Place {
    places: Places,
    address: IpAddr,
}

/// Why there is no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Full {
    All,
    Address,
}

impl Places {
    pub(super) fn new(most: usize, most_of_one: usize) -> Self {
        Self(Arc::new(Inner { most, most_of_one, taken: Mutex::default() }))
    }

    /// Takes a place for a peer.
    pub(super) fn take(&self, peer: IpAddr) -> Result<Place, Full> {
        let address = household(peer);
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
        Ok(Place { places: self.clone(), address })
    }

    fn taken(&self) -> MutexGuard<'_, Taken> {
        self.0.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = self.places.taken();
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

/// What counts as one peer: an IPv4 address, or the /64 that an IPv6 host may choose its addresses from.
pub(super) fn household(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V4(v4) => IpAddr::V4(v4),
        IpAddr::V6(v6) if v6.is_loopback() => IpAddr::V6(v6),
        IpAddr::V6(v6) => IpAddr::V6(Ipv6Addr::from_bits(v6.to_bits() & !u128::from(u64::MAX))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(places: &Places, address: &str) -> Result<Place, Full> {
        places.take(address.parse().unwrap())
    }

    #[test]
    fn one_address_cannot_take_them_all_and_what_is_given_back_is_free() {
        let places = Places::new(3, 2);
        let first = take(&places, "10.0.0.1").unwrap();
        let _second = take(&places, "::ffff:10.0.0.1").unwrap();
        assert_eq!(take(&places, "10.0.0.1").err(), Some(Full::Address));
        let _third = take(&places, "10.0.0.2").unwrap();
        assert_eq!(take(&places, "10.0.0.3").err(), Some(Full::All));
        drop(first);
        let _fourth = take(&places, "10.0.0.1").unwrap();
        assert_eq!(places.taken().by_address.len(), 2);
    }

    #[test]
    fn a_host_with_many_ipv6_addresses_is_one_peer() {
        let places = Places::new(9, 1);
        let _one = take(&places, "2001:db8::1").unwrap();
        assert_eq!(take(&places, "2001:db8::2").err(), Some(Full::Address));
        take(&places, "2001:db8:0:1::1").unwrap();
        take(&places, "::1").unwrap();
    }
}
