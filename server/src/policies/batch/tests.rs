//! What goes through a model together, how long it waits for that, and what it does not run at all.

use std::pin::pin;

use futures::poll;

use super::{
    super::{
        engine::Ask,
        pace::Seat,
        testing::{FAILS, GIVES_NAN, PANICS, TestEngine, engine, turn},
    },
    *,
};
use crate::{domain::observation::Timings, error::Kind};

/// Longer than any model of a test takes, shorter than a test may.
const SOON: Duration = Duration::from_millis(50);

fn ask(proprioception: f32, within: Option<Duration>) -> (Ask<(f32, Vec<f32>)>, Arc<Stages>) {
    let stages = Arc::new(Stages::begin());
    let deadline = within.map(|within| stages.arrived() + within);
    (Ask { turn: turn(proprioception), stages: Arc::clone(&stages), deadline }, stages)
}

/// Asks, and gives the answer's timings.
async fn timed(engine: &TestEngine, proprioception: f32) -> Timings {
    let (ask, stages) = ask(proprioception, None);
    engine.ask_by(ask).await.unwrap().advanced().unwrap();
    stages.timings()
}

fn present(engine: &TestEngine, period: Option<Duration>) -> Seat {
    let seat = engine.join(period);
    seat.asks();
    seat
}

#[tokio::test]
async fn what_waits_is_answered_together_up_to_the_limit() {
    let (engine, mut control) = engine(2, 8).await;
    let mut first = pin!(engine.ask(turn(1.0)));
    assert!(poll!(&mut first).is_pending());
    assert_eq!(control.begun.recv().await, Some(1), "an idle model does not wait for more");
    let mut rest = pin!(futures::future::join3(engine.ask(turn(2.0)), engine.ask(turn(3.0)), engine.ask(turn(4.0))));
    assert!(poll!(&mut rest).is_pending());
    control.gate.send(()).unwrap();
    assert_eq!(first.await.unwrap().actions, [[1.0, 0.0]]);
    assert_eq!(control.begun.recv().await, Some(2));
    control.gate.send(()).unwrap();
    assert_eq!(control.begun.recv().await, Some(1));
    control.gate.send(()).unwrap();
    let (two, three, four) = rest.await;
    let actions = [two, three, four].map(|answer| answer.unwrap().actions[0][0]);
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
        assert_eq!(whole.unwrap().actions, [[2.0, 0.0]]);
        engine.ask(turn(3.0)).await.unwrap();
    }
}

#[tokio::test]
async fn what_is_late_before_the_model_is_free_is_not_run() {
    let (engine, mut control) = engine(8, 8).await;
    let mut busy = pin!(engine.ask(turn(1.0)));
    assert!(poll!(&mut busy).is_pending());
    assert_eq!(control.begun.recv().await, Some(1));
    let (mut late, _) = ask(2.0, Some(Duration::ZERO));
    late.turn.history = Some((9.0, vec![8.0]));
    let mut both = pin!(futures::future::join(engine.ask_by(late), engine.ask(turn(3.0))));
    assert!(poll!(&mut both).is_pending());
    drop(control.gate);
    let (late, in_time) = both.await;
    assert!(matches!(late.unwrap(), Turned::Late(Some((9.0, executed))) if executed == [8.0]), "as it was");
    assert_eq!(in_time.unwrap().actions, [[3.0, 0.0]]);
    assert_eq!(control.begun.recv().await, Some(1), "the one in time");
    assert!(control.begun.try_recv().is_err(), "nothing else was run");
    let error = Turned::<()>::Late(None).advanced().unwrap_err();
    assert_eq!(error.kind(), Kind::Late);
}

#[tokio::test]
async fn a_free_model_waits_for_the_sessions_that_are_present() {
    let (engine, mut control) = engine(8, 8).await;
    drop(control.gate);
    // A part of these periods is longer than any test may take: it must be the second that begins the batch.
    let _seats = (present(&engine, None), present(&engine, None));
    let mut first = pin!(timed(&engine, 1.0));
    assert!(poll!(&mut first).is_pending());
    let quiet = tokio::time::timeout(SOON, control.begun.recv()).await;
    assert!(quiet.is_err(), "it waits");
    let (first, second) = futures::join!(first, timed(&engine, 2.0));
    assert_eq!(control.begun.recv().await, Some(2));
    assert_eq!((first.batch_size, second.batch_size), (2, 2));
    assert!(first.batch_us >= 40_000, "{first:?}");
    assert!(first.batch_us > second.batch_us, "the second did not wait for itself: {first:?} {second:?}");
}

#[tokio::test]
async fn many_sessions_go_through_the_model_in_two_waves() {
    for (sessions, others, waves) in [(4, 0, vec![4]), (5, 0, vec![4, 1]), (10, 0, vec![5, 5]), (2, 10, vec![6, 4, 2])]
    {
        let (engine, mut control) = engine(16, 16).await;
        let mut busy = pin!(engine.ask(turn(0.5)));
        assert!(poll!(&mut busy).is_pending());
        assert_eq!(control.begun.recv().await, Some(1));
        // A part of these periods is longer than any test may take: nobody waits for those who have just been answered.
        let _seats: Vec<Seat> = (0..sessions).map(|_| present(&engine, None)).collect();
        let asks = (0..sessions + others).map(|_| engine.ask(turn(1.0)));
        let mut all = pin!(futures::future::try_join_all(asks));
        assert!(poll!(&mut all).is_pending());
        drop(control.gate);
        busy.await.unwrap();
        all.await.unwrap();
        for wave in waves {
            assert_eq!(control.begun.recv().await, Some(wave), "of {sessions} and {others}");
        }
    }
}

#[tokio::test]
async fn a_session_alone_is_never_held_up() {
    let (engine, control) = engine(8, 8).await;
    drop(control.gate);
    let _seats = (present(&engine, None), engine.join(None));
    let timings = timed(&engine, 1.0).await;
    assert_eq!((timings.batch_size, timings.batch_us), (1, 0));
}

#[tokio::test]
async fn a_session_that_stays_away_delays_nobody_for_long() {
    let (engine, mut control) = engine(8, 8).await;
    drop(control.gate);
    let _seats = (present(&engine, None), present(&engine, Some(SOON)));
    let timings = timed(&engine, 1.0).await;
    assert_eq!(control.begun.recv().await, Some(1));
    assert!(timings.batch_us < 1_000_000, "a part of the fastest period at most: {timings:?}");
}

#[tokio::test]
async fn waiting_for_others_ends_before_a_deadline() {
    let (engine, control) = engine(8, 8).await;
    drop(control.gate);
    let _seats = (present(&engine, None), present(&engine, None));
    // The estimate of the model's time is then that of a turn, not of the warm-up.
    futures::join!(timed(&engine, 1.0), timed(&engine, 2.0));
    let (ask, stages) = ask(3.0, Some(Duration::from_secs(1)));
    let turned = engine.ask_by(ask).await.unwrap();
    assert!(matches!(turned, Turned::Advanced(_)), "{turned:?}");
    assert_eq!(stages.timings().batch_size, 1);
}
