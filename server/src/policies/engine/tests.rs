//! Batching, isolation and the end of a model's thread.

#![allow(clippy::unwrap_used, clippy::panic)]
use futures::poll;
use std::pin::pin;

use super::{
    super::testing::{FAILS, GIVES_NAN, PANICS, Parrot, engine, identity, turn},
    *,
};
use crate::error::Kind;

#[tokio::test]
async fn what_waits_is_answered_together_up_to_the_limit() {
    let (engine, mut control) = engine(2, 8).await;
    let mut first = pin!(engine.ask(turn(1.0)));
    assert!(poll!(&mut first).is_pending());
    assert_eq!(control.begun.recv().await, Some(1), "an idle model does not wait for more");
    let mut rest = pin!(futures::future::join3(engine.ask(turn(2.0)), engine.ask(turn(3.0)), engine.ask(turn(4.0))));
    assert!(poll!(&mut rest).is_pending());
    control.gate.send(()).unwrap();
    assert_eq!(first.await.unwrap().advanced.actions, [[1.0, 0.0]]);
    assert_eq!(control.begun.recv().await, Some(2));
    control.gate.send(()).unwrap();
    assert_eq!(control.begun.recv().await, Some(1));
    control.gate.send(()).unwrap();
    let (two, three, four) = rest.await;
    let actions = [two, three, four].map(|answer| answer.unwrap().advanced.actions[0][0]);
    assert_eq!(actions, [2.0, 3.0, 4.0], "each caller gets its own answer");
}

#[tokio::test]
async fn callers_that_have_gone_cost_nothing() {
    let (engine, mut control) = engine(8, 8).await;
    let mut busy = pin!(engine.ask(turn(1.0)));
    assert!(poll!(&mut busy).is_pending());
    assert_eq!(control.begun.recv().await, Some(1));
    let mut stays = pin!(engine.ask(turn(3.0)));
    {
        let mut goes = pin!(engine.ask(turn(2.0)));
        assert!(poll!(&mut goes).is_pending() && poll!(&mut stays).is_pending());
    }
    drop(control.gate);
    busy.await.unwrap();
    stays.await.unwrap();
    assert_eq!(control.begun.recv().await, Some(1), "the one that stayed");
    assert!(control.begun.try_recv().is_err(), "nothing was run for the one that went");
}

#[tokio::test]
async fn a_turn_that_breaks_the_model_breaks_no_other() {
    for (bad, named) in [(PANICS, "told to"), (FAILS, "told to"), (GIVES_NAN, "not finite")] {
        let (engine, mut control) = engine(8, 8).await;
        let mut busy = pin!(engine.ask(turn(1.0)));
        assert!(poll!(&mut busy).is_pending());
        assert_eq!(control.begun.recv().await, Some(1));
        let mut both = pin!(futures::future::join(engine.ask(turn(bad)), engine.ask(turn(2.0))));
        assert!(poll!(&mut both).is_pending());
        drop(control.gate);
        let (broken, whole) = both.await;
        let error = broken.unwrap_err();
        assert_eq!(error.kind(), Kind::Internal);
        assert!(error.to_string().contains(named), "{error}");
        assert_eq!(whole.unwrap().advanced.actions, [[2.0, 0.0]]);
        engine.ask(turn(3.0)).await.unwrap();
    }
}

#[tokio::test]
async fn a_full_queue_refuses_those_who_will_not_wait() {
    let (engine, mut control) = engine(1, 1).await;
    let mut busy = pin!(engine.ask(turn(1.0)));
    assert!(poll!(&mut busy).is_pending());
    assert_eq!(control.begun.recv().await, Some(1));
    let mut waits = pin!(futures::future::join(engine.try_ask(turn(2.0)), engine.ask(turn(3.0))));
    assert!(poll!(&mut waits).is_pending());
    assert_eq!(engine.try_ask(turn(4.0)).await.unwrap_err().kind(), Kind::Exhausted);
    drop(control.gate);
    let (queued, waited) = waits.await;
    assert!(queued.is_ok() && waited.is_ok(), "a session waits for its place instead");
}

#[tokio::test]
async fn closing_answers_what_waits_and_refuses_the_rest() {
    let (engine, mut control) = engine(8, 8).await;
    let mut waits = pin!(engine.ask(turn(1.0)));
    assert!(poll!(&mut waits).is_pending());
    assert_eq!(control.begun.recv().await, Some(1));
    drop(control.gate);
    let closing = Arc::clone(&engine);
    tokio::task::spawn_blocking(move || closing.close()).await.unwrap();
    assert!(waits.await.is_ok());
    assert_eq!(engine.ask(turn(2.0)).await.unwrap_err().kind(), Kind::Unavailable);
}

#[tokio::test]
async fn a_model_that_cannot_be_loaded_says_why() {
    let load = || Err(Error::precondition("another version"));
    let error = Engine::<Parrot>::start(identity(1, 1), load).await.err().unwrap();
    assert_eq!((error.kind(), error.message()), (Kind::Precondition, "another version"));
    let error = Engine::<Parrot>::start(identity(1, 1), || panic!("torn")).await.err().unwrap();
    assert!(error.to_string().contains("torn"), "{error}");
}
