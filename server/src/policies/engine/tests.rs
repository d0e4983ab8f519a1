//! Start, queue and end of a model's thread.

use futures::poll;
use std::pin::pin;

use super::{
    super::testing::{Parrot, engine, identity, input},
    *,
};
use crate::error::Kind;

#[tokio::test]
async fn a_full_queue_refuses_callers_that_do_not_wait() {
    let (engine, mut control) = engine(1, 1).await;
    let mut busy = pin!(engine.infer(input(1.0)));
    assert!(poll!(&mut busy).is_pending());
    assert_eq!(control.begun.recv().await, Some(1));
    let mut waits = pin!(futures::future::join(engine.try_infer(input(2.0)), engine.infer(input(3.0))));
    assert!(poll!(&mut waits).is_pending());
    assert_eq!(engine.try_infer(input(4.0)).await.unwrap_err().kind(), Kind::Exhausted);
    drop(control.gate);
    let (queued, waited) = waits.await;
    assert!(queued.is_ok() && waited.is_ok(), "a session waits for its place instead");
}

#[tokio::test]
async fn closing_answers_the_queue_and_refuses_later_requests() {
    let (engine, mut control) = engine(8, 8).await;
    let mut waits = pin!(engine.infer(input(1.0)));
    assert!(poll!(&mut waits).is_pending());
    assert_eq!(control.begun.recv().await, Some(1));
    drop(control.gate);
    let closing = Arc::clone(&engine);
    tokio::task::spawn_blocking(move || closing.close()).await.unwrap();
    assert!(waits.await.is_ok());
    assert_eq!(engine.infer(input(2.0)).await.unwrap_err().kind(), Kind::Unavailable);
}

#[tokio::test]
async fn a_model_that_cannot_be_loaded_returns_its_error() {
    let load = || Err(Error::precondition("another version"));
    let error = Engine::<Parrot>::start(identity(1, 1), load).await.err().unwrap();
    assert_eq!((error.kind(), error.message()), (Kind::Precondition, "another version"));
    let error = Engine::<Parrot>::start(identity(1, 1), || panic!("torn")).await.err().unwrap();
    assert!(error.to_string().contains("torn"), "{error}");
}
