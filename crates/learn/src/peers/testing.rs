//! Ranks of a group for tests, each on a thread of its own. Their tests run in processes of their own, because an error on
//! a thread of gloo ends the process.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;

use gleaner_group::{Meeting, Place};

use super::Peers;
use crate::device;
use crate::toy::Recorder;

const LOCAL: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
const TIMEOUT: Duration = Duration::from_secs(60);

/// What each rank of a group returns and reports; `stop_after` is each rank's own.
pub(crate) fn ranks<T: Send>(
    stop_after: &[Option<usize>],
    work: impl Fn(&mut Peers, &mut Recorder) -> T + Sync,
) -> Vec<(T, Recorder)> {
    ranks_within(TIMEOUT, stop_after, work)
}

/// As [`ranks`], where the ranks wait so long for each other.
pub(crate) fn ranks_within<T: Send>(
    timeout: Duration,
    stop_after: &[Option<usize>],
    work: impl Fn(&mut Peers, &mut Recorder) -> T + Sync,
) -> Vec<(T, Recorder)> {
    let count = u32::try_from(stop_after.len()).unwrap();
    let first = Meeting::open(count, timeout).unwrap();
    let at = SocketAddr::new(LOCAL, first.port());
    let mut meetings = vec![first];
    meetings.extend((1..count).map(|_| Meeting::find(at, count, timeout).unwrap()));
    let (ended, all) = channel();
    thread::scope(|scope| {
        for (rank, (meeting, stop_after)) in (0..count).zip(meetings.into_iter().zip(stop_after)) {
            let (work, ended) = (&work, ended.clone());
            // Other tests change the number of threads of the process, on which the last bits depend.
            let started = device::spawn_single(scope, move || {
                let place = Place { rank, ranks: count, address: LOCAL, gpu: false };
                let mut peers = Peers::of(meeting.join("learn", place).unwrap());
                let mut monitor = Recorder { stop_after: *stop_after, ..Recorder::default() };
                ended.send((rank, (work(&mut peers, &mut monitor), monitor))).unwrap();
            });
            started.unwrap();
        }
    });
    drop(ended);
    let by_rank: BTreeMap<u32, _> = all.iter().collect();
    assert_eq!(by_rank.len(), stop_after.len(), "a rank panicked");
    by_rank.into_values().collect()
}
