//! `Act` with a model that echoes its history.

use std::time::Duration;

use super::{
    super::testing::{engine, observation},
    *,
};
use crate::error::Kind;

#[tokio::test]
async fn act_takes_the_window_that_the_caller_keeps() {
    let (engine, control) = engine(8, 8).await;
    drop(control);
    let seen = [observation(1, &[]), observation(2, &[]), observation(3, &[7.0, 0.0]), observation(4, &[5.0, 0.0])];
    let acted = act(&engine, seen.to_vec()).await.unwrap();
    assert_eq!((acted.stamp_ns, acted.actions), (4, vec![vec![4.0, 12.0]]), "the window is the last three");

    let error = act(&engine, Vec::new()).await.unwrap_err();
    assert!(error.message().starts_with("observations: "), "{error}");
    let error = act(&engine, vec![observation(1, &[]), observation(2, &[])]).await.unwrap_err();
    assert!(error.message().starts_with("observations[1].executed_action: "), "{error}");
}

#[tokio::test]
async fn act_honours_the_deadline_of_the_last_observation() {
    let (engine, control) = engine(8, 8).await;
    let mut first = observation(1, &[]);
    first.deadline = Some(Duration::ZERO);
    let mut last = observation(2, &[0.0, 0.0]);
    last.deadline = Some(Duration::from_millis(20));
    // The model does not finish while the gate is shut.
    let error = act(&engine, vec![first.clone(), last]).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Late, "{error}");
    drop(control.gate);
    let acted = act(&engine, vec![first, observation(3, &[0.0, 0.0])]).await.unwrap();
    assert_eq!((acted.stamp_ns, acted.timings.batch_size), (3, 1), "the deadline of an older observation is ignored");
}
