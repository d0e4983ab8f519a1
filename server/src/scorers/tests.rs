//! Watches: which segments are scored, which are left out, and that watches do not wait for each other.

mod loaded_runs;
mod steps;

use std::sync::Arc;

use gleaner_learn::Trajectory;
use tokio::sync::Semaphore;

use super::testing::{FAILS, PANICS, ready, scored, seen, step};
use crate::{error::Kind, ingest::testing::room};

#[tokio::test]
async fn each_step_is_scored_with_the_steps_before_it() {
    let (ready, control) = ready().await;
    drop(control.gate);
    let mut watch = ready.watch();
    assert_eq!(watch.newest(), None);
    for stamp in 1..=4 {
        step(&mut watch, stamp);
        watch.settle().await;
        assert_eq!(watch.newest().unwrap().stamp_ns, i64::from(stamp));
    }
    let newest = watch.newest().unwrap();
    assert_eq!((&newest.match_episode, newest.match_step), (&ready.experts()[0], 7));
    assert_eq!(scored(&mut watch), [(1, -1.0), (2, -102.0), (3, -10203.0), (4, -20304.0)]);
    assert!(scored(&mut watch).is_empty(), "taken once");
    assert_eq!(watch.left_out(), 0);
}

#[tokio::test]
async fn an_observation_is_scored_once_its_action_is_known() {
    let (ready, control) = ready().await;
    drop(control.gate);
    let mut watch = ready.watch();
    watch.executed(&[9.0]);
    watch.saw(seen(1, 0.0));
    watch.settle().await;
    assert_eq!(watch.newest(), None);
    watch.executed(&[1.0]);
    watch.executed(&[2.0]);
    watch.settle().await;
    assert_eq!(scored(&mut watch), [(1, -1.0)]);
}

/// The newest score of a busy scorer belongs to a whole segment of consecutive steps.
#[tokio::test]
async fn a_busy_scorer_leaves_out_older_steps() {
    let (ready, mut control) = ready().await;
    let mut watch = ready.watch();
    step(&mut watch, 1);
    assert_eq!(control.begun.recv().await, Some(1));
    for stamp in 2..=20 {
        step(&mut watch, stamp);
    }
    drop(control.gate);
    watch.settle().await;
    let found = scored(&mut watch);
    assert_eq!((found[0], *found.last().unwrap()), ((1, -1.0), (20, -181_920.0)));
    assert!(found.iter().skip(1).all(|&(stamp, w)| {
        let stamp = f64::from(i32::try_from(stamp).unwrap());
        w == -((stamp - 2.0) * 10_000.0 + (stamp - 1.0) * 100.0 + stamp)
    }));
    assert_eq!(found.len() as u64 + watch.left_out(), 20, "{found:?}");
    assert!(found.len() <= 6, "at most two segments of steps wait: {found:?}");
}

#[tokio::test]
async fn a_gap_is_in_no_segment() {
    let (ready, control) = ready().await;
    drop(control.gate);
    let mut watch = ready.watch();
    step(&mut watch, 1);
    watch.saw(seen(2, 0.0));
    for stamp in 3..=6 {
        step(&mut watch, stamp);
        watch.settle().await;
    }
    assert_eq!(scored(&mut watch), [(1, -1.0), (5, -30405.0), (6, -40506.0)]);
    assert_eq!(watch.left_out(), 2);
}

#[tokio::test]
async fn segments_that_span_a_gap_are_incomplete_even_before_the_first_step() {
    let (ready, control) = ready().await;
    drop(control.gate);
    let mut watch = ready.watch();
    watch.gap();
    for stamp in 1..=3 {
        step(&mut watch, stamp);
    }
    watch.saw(seen(4, 0.0));
    watch.gap();
    watch.executed(&[1.0]);
    for stamp in 5..=7 {
        step(&mut watch, stamp);
        watch.settle().await;
    }
    assert_eq!(scored(&mut watch), [(3, -10203.0), (7, -50607.0)]);
    assert_eq!(watch.left_out(), 4);
}

#[tokio::test]
async fn waiting_episodes_are_batched_and_only_the_faulty_one_fails() {
    for fault in [PANICS, FAILS] {
        let (ready, mut control) = ready().await;
        let (mut first, mut good, mut bad) = (ready.watch(), ready.watch(), ready.watch());
        step(&mut first, 1);
        assert_eq!(control.begun.recv().await, Some(1));
        step(&mut good, 1);
        bad.saw(seen(1, fault));
        bad.executed(&[1.0]);
        drop(control.gate);
        good.settle().await;
        bad.settle().await;
        assert_eq!(control.begun.recv().await, Some(2));
        assert_eq!((scored(&mut good), scored(&mut bad)), (vec![(1, -1.0)], vec![]));
        assert!(bad.take_fault().unwrap().to_string().contains("on demand") && good.take_fault().is_none());
        for stamp in 2..=4 {
            step(&mut bad, stamp);
            bad.settle().await;
        }
        assert_eq!(scored(&mut bad), [(4, -20304.0)], "the history restarts");
        assert!(bad.take_fault().is_none());
    }
}

#[tokio::test]
async fn steps_of_a_dropped_watch_are_not_scored() {
    let (ready, mut control) = ready().await;
    let (mut first, mut gone) = (ready.watch(), ready.watch());
    step(&mut first, 1);
    assert_eq!(control.begun.recv().await, Some(1));
    step(&mut gone, 1);
    drop(gone);
    step(&mut first, 2);
    control.gate.send(()).unwrap();
    assert_eq!(control.begun.recv().await, Some(1));
}

#[tokio::test]
async fn a_closing_scorer_leaves_no_watch_waiting() {
    let (ready, control) = ready().await;
    let mut watch = ready.watch();
    step(&mut watch, 1);
    drop(control.gate);
    let closing = std::sync::Arc::clone(&ready);
    tokio::task::spawn_blocking(move || closing.engine.close()).await.unwrap();
    assert_eq!(scored(&mut watch), [(1, -1.0)], "waiting steps are scored");
    step(&mut watch, 2);
    watch.settle().await;
    assert_eq!((scored(&mut watch).len(), watch.left_out()), (0, 1));
}

#[tokio::test]
async fn a_waiting_whole_episode_keeps_its_room_and_is_refused_by_a_closing_scorer() {
    let (ready, mut control) = ready().await;
    let mut watch = ready.watch();
    step(&mut watch, 1);
    assert_eq!(control.begun.recv().await, Some(1));
    let rooms = Arc::new(Semaphore::new(2));
    let whole = || {
        let steps = Trajectory::new(ready.shape(), "whole", Vec::new(), vec![0.0], vec![0.0]).unwrap();
        ready.engine.episode(steps, room(&rooms))
    };
    let (mut gone, mut waits) = (Box::pin(whole()), Box::pin(whole()));
    assert!(futures::poll!(&mut gone).is_pending() && futures::poll!(&mut waits).is_pending());
    drop(gone);
    assert_eq!(rooms.available_permits(), 0, "both are in memory");
    let closing = Arc::clone(&ready);
    let closed = tokio::task::spawn_blocking(move || closing.engine.close());
    loop {
        let mut late = ready.watch();
        step(&mut late, 1);
        if late.left_out() == 1 {
            break;
        }
        tokio::task::yield_now().await;
    }
    drop(control.gate);
    assert_eq!(waits.await.unwrap_err().kind(), Kind::Unavailable);
    closed.await.unwrap();
    assert_eq!(rooms.available_permits(), 2);
}
