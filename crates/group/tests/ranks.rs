//! Groups of two and three ranks, each on a thread of its own: what they compute, and how they end.

#![allow(clippy::unwrap_used)]

use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    sync::{Arc, Mutex, mpsc::channel},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use gleaner_group::{Group, GroupError, Meeting, Place};
use tch::{Kind, Tensor};

const LOCAL: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
/// For groups whose ranks all work.
const LONG: Duration = Duration::from_secs(60);
/// For groups in which one hangs or is missing: long enough for the others to meet on a busy machine.
const SHORT: Duration = Duration::from_secs(10);

fn place(rank: u32, ranks: u32) -> Place {
    Place { rank, ranks, address: LOCAL, gpu: false }
}

/// Starts the threads of a group; `work` is what each rank does.
fn group<T: Send + 'static>(
    ranks: u32,
    timeout: Duration,
    work: impl Fn(Group) -> T + Clone + Send + 'static,
) -> Vec<JoinHandle<T>> {
    let first = Meeting::open(ranks, timeout).unwrap();
    let at = SocketAddr::new(LOCAL, first.port());
    let mut meetings = vec![first];
    meetings.extend((1..ranks).map(|_| Meeting::find(at, ranks, timeout).unwrap()));
    let start = |(meeting, rank): (Meeting, u32)| {
        let work = work.clone();
        thread::spawn(move || work(meeting.join("test", place(rank, ranks)).unwrap()))
    };
    meetings.into_iter().zip(0..).map(start).collect()
}

fn all<T>(threads: Vec<JoinHandle<T>>) -> Vec<T> {
    threads.into_iter().map(|thread| thread.join().unwrap()).collect()
}

fn values(tensor: &Tensor) -> Vec<f32> {
    Vec::try_from(tensor.flatten(0, -1)).unwrap()
}

/// Numbers whose sum depends on the order of the additions.
fn numbers(rank: u32) -> Tensor {
    let at = Tensor::arange(100_003, (Kind::Float, tch::Device::Cpu));
    (at * (0.1 + f64::from(rank) * 0.7)).sin() * 10f64.powi(i32::try_from(rank).unwrap() * 3)
}

fn sums(ranks: u32) -> Vec<Vec<u32>> {
    let bits = |mut group: Group| {
        let mut tensor = numbers(group.rank());
        group.sum(&mut tensor).unwrap();
        values(&tensor).into_iter().map(f32::to_bits).collect()
    };
    all(group(ranks, LONG, bits))
}

#[test]
fn every_rank_gets_the_same_bits_in_every_run() {
    for ranks in [2, 3] {
        let first = sums(ranks);
        assert!(first.iter().all(|bits| *bits == first[0]), "ranks of {ranks} differ");
        assert_eq!(first, sums(ranks), "runs of {ranks} ranks differ");
        let exact = (0..ranks).map(|rank| numbers(rank).to_kind(Kind::Double)).sum::<Tensor>();
        let found: Vec<f32> = first[0].iter().copied().map(f32::from_bits).collect();
        let worst = (Tensor::from_slice(&found) - exact).abs().max().double_value(&[]);
        assert!(worst < 10f64.powi(i32::try_from(ranks - 1).unwrap() * 3) * 1e-5, "{worst}");
    }
}

#[test]
fn a_broadcast_and_a_sum_of_a_view_change_the_view() {
    let done = all(group(2, LONG, |mut group| {
        let whole = Tensor::from_slice(&[1f32, 2., 3., 4.]).view([2, 2]) * f64::from(group.rank() + 1);
        let mut column = whole.select(1, 1);
        group.sum(&mut column).unwrap();
        let summed = values(&whole);
        group.broadcast(&mut whole.shallow_clone()).unwrap();
        (summed, values(&whole), group.ranks())
    }));
    assert_eq!(done[0], (vec![1., 6., 3., 12.], vec![1., 6., 3., 12.], 2));
    assert_eq!(done[1], (vec![2., 6., 6., 12.], vec![1., 6., 3., 12.], 2));
}

/// The last rank ends instead of the second sum or, where `hangs`, stays connected until the others have returned.
/// Returns what the others get, and how long they wait for it.
fn with_one_missing(ranks: u32, timeout: Duration, hangs: bool) -> Vec<(GroupError, GroupError, Duration)> {
    let (release, released) = channel::<()>();
    let released = Arc::new(Mutex::new(released));
    let work = move |mut group: Group| {
        let mut tensor = Tensor::from_slice(&[1f32]);
        group.sum(&mut tensor).unwrap();
        if group.rank() + 1 == group.ranks() {
            if hangs {
                released.lock().unwrap().recv().unwrap_err();
            }
            return None;
        }
        let begun = Instant::now();
        let error = group.sum(&mut tensor).unwrap_err();
        let waited = begun.elapsed();
        Some((error, group.sum(&mut tensor).unwrap_err(), waited))
    };
    let mut threads = group(ranks, timeout, work);
    let last = threads.pop().unwrap();
    let ended = all(threads).into_iter().flatten().collect();
    drop(release);
    assert!(last.join().unwrap().is_none());
    ended
}

#[test]
fn the_end_of_a_rank_ends_the_others_before_the_timeout_and_for_good() {
    for ranks in [2, 3] {
        let ended = with_one_missing(ranks, LONG, false);
        assert_eq!(ended.len() + 1, ranks as usize);
        // A rank without a connection to the one that ended waits for one that has; both end before the timeout does.
        for (error, again, waited) in ended {
            assert!(matches!(error, GroupError::Gone { .. }), "{error}");
            assert_eq!(error, again);
            assert!(waited < LONG, "{waited:?}");
        }
    }
}

#[test]
fn a_rank_that_hangs_ends_the_others_after_the_timeout() {
    let groups = [2, 3].map(|ranks| thread::spawn(move || with_one_missing(ranks, SHORT, true)));
    for ended in groups {
        let ended = ended.join().unwrap();
        // The first to return ends its connections, which ends the others.
        let silent = |error: &GroupError| matches!(error, GroupError::Silent { .. });
        assert!(ended.iter().any(|(error, _, waited)| silent(error) && *waited >= SHORT), "{ended:?}");
        for (error, again, _) in ended {
            assert!(silent(&error) || matches!(error, GroupError::Gone { .. }), "{error}");
            assert_eq!(error, again);
        }
    }
}

#[test]
fn a_missing_rank_is_reported_when_joining() {
    let meeting = Meeting::open(2, SHORT).unwrap();
    let error = meeting.join("test", place(0, 2)).unwrap_err();
    assert!(matches!(error, GroupError::Join { rank: 0, ranks: 2, seconds: 10, .. }), "{error}");
    let closed = std::net::TcpListener::bind((LOCAL, 0)).unwrap().local_addr().unwrap();
    let error = Meeting::find(closed, 2, Duration::from_secs(1)).err().unwrap();
    assert!(error.to_string().starts_with(&format!("the ranks cannot meet: rank 0 at {closed}: ")), "{error}");
    let meeting = Meeting::open(2, SHORT).unwrap();
    assert_eq!(meeting.join("test", place(2, 2)).unwrap_err(), GroupError::Place { rank: 2, ranks: 2 });
}
