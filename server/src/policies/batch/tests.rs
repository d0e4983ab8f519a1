//! Batching, waiting for other sessions, and deadlines.

use std::pin::pin;

use futures::poll;

use super::{
    super::{
        engine::InferenceRequest,
        session_rates::RateGuard,
        testing::{FAILS, GIVES_NAN, HELD, PANICS, TestEngine, engine, input},
    },
    *,
};
use crate::{domain::observation::Timings, error::Kind};

/// Longer than the model of any test takes, shorter than the time limit of a test.
const SOON: Duration = Duration::from_millis(50);

fn request(proprioception: f32, within: Option<Duration>) -> (InferenceRequest<(f32, Vec<f32>)>, Arc<Stages>) {
    let stages = Arc::new(Stages::begin());
    let deadline = within.map(|within| stages.arrived() + within);
    (InferenceRequest { input: input(proprioception), stages: Arc::clone(&stages), deadline }, stages)
}

/// Sends a request and returns its timings.
async fn timed(engine: &TestEngine, proprioception: f32) -> Timings {
    let (call, stages) = request(proprioception, None);
    engine.infer_by(call).await.unwrap().advanced().unwrap();
    stages.timings()
}

fn present(engine: &TestEngine, period: Option<Duration>) -> RateGuard {
    let guard = engine.join(period);
    guard.record_request();
    guard
}

#[tokio::test]
async fn waiting_requests_are_answered_together_up_to_the_batch_limit() {
    let (engine, mut control) = engine(2, 8).await;
    let mut first = pin!(engine.infer(input(1.0)));
    assert!(poll!(&mut first).is_pending());
    assert_eq!(control.begun.recv().await, Some(1), "an idle model does not wait for more");
    let mut rest =
        pin!(futures::future::join3(engine.infer(input(2.0)), engine.infer(input(3.0)), engine.infer(input(4.0))));
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

/// The rest of a chunk is sent before the batch that it arrived with, and takes no place in it.
#[tokio::test]
async fn a_request_that_needs_no_pass_waits_for_no_other() {
    let (engine, mut control) = engine(8, 8).await;
    let mut first = pin!(engine.infer(input(1.0)));
    assert!(poll!(&mut first).is_pending());
    assert_eq!(control.begun.recv().await, Some(1));
    let (mut two, mut held) = (pin!(engine.infer(input(2.0))), pin!(engine.infer(input(HELD))));
    let mut three = pin!(engine.infer(input(3.0)));
    assert!(poll!(&mut two).is_pending() && poll!(&mut held).is_pending() && poll!(&mut three).is_pending());
    control.gate.send(()).unwrap();
    first.await.unwrap();
    control.gate.send(()).unwrap();
    control.gate.send(()).unwrap();
    assert_eq!(held.await.unwrap().actions, [[HELD, 0.0]]);
    let (two, three) = futures::future::join(two, three).await;
    assert_eq!([two, three].map(|answer| answer.unwrap().actions[0][0]), [2.0, 3.0]);
    let mut sizes = [control.begun.recv().await.unwrap(), control.begun.recv().await.unwrap()];
    sizes.sort_unstable();
    assert_eq!(sizes, [1, 2], "one pass for the two others, none for the held one");
}

#[tokio::test]
async fn requests_of_disconnected_callers_are_not_run() {
    let (engine, mut control) = engine(8, 8).await;
    let mut busy = pin!(engine.infer(input(1.0)));
    assert!(poll!(&mut busy).is_pending());
    assert_eq!(control.begun.recv().await, Some(1));
    let mut stays = pin!(engine.infer(input(3.0)));
    {
        let mut goes = pin!(engine.infer(input(2.0)));
        assert!(poll!(&mut goes).is_pending() && poll!(&mut stays).is_pending());
    }
    drop(control.gate);
    busy.await.unwrap();
    stays.await.unwrap();
    assert_eq!(control.begun.recv().await, Some(1), "the remaining caller");
    assert!(control.begun.try_recv().is_err(), "the dropped request was not run");
}

#[tokio::test]
async fn an_input_that_fails_in_the_model_fails_no_other() {
    for (bad, named) in [(PANICS, "on demand"), (FAILS, "on demand"), (GIVES_NAN, "not finite")] {
        let (engine, mut control) = engine(8, 8).await;
        let mut busy = pin!(engine.infer(input(1.0)));
        assert!(poll!(&mut busy).is_pending());
        assert_eq!(control.begun.recv().await, Some(1));
        let mut both = pin!(futures::future::join(engine.infer(input(bad)), engine.infer(input(2.0))));
        assert!(poll!(&mut both).is_pending());
        drop(control.gate);
        let (broken, whole) = both.await;
        let error = broken.unwrap_err();
        assert_eq!(error.kind(), Kind::Internal);
        assert!(error.to_string().contains(named), "{error}");
        assert_eq!(whole.unwrap().actions, [[2.0, 0.0]]);
        engine.infer(input(3.0)).await.unwrap();
    }
}

#[tokio::test]
async fn a_request_past_its_deadline_is_not_run() {
    let (engine, mut control) = engine(8, 8).await;
    let mut busy = pin!(engine.infer(input(1.0)));
    assert!(poll!(&mut busy).is_pending());
    assert_eq!(control.begun.recv().await, Some(1));
    let (mut late, _) = request(2.0, Some(Duration::ZERO));
    late.input.history = Some((9.0, vec![8.0]));
    let mut both = pin!(futures::future::join(engine.infer_by(late), engine.infer(input(3.0))));
    assert!(poll!(&mut both).is_pending());
    drop(control.gate);
    let (late, in_time) = both.await;
    assert!(matches!(late.unwrap(), StepResult::Late(Some((9.0, executed))) if executed == [8.0]), "as it was");
    assert_eq!(in_time.unwrap().actions, [[3.0, 0.0]]);
    assert_eq!(control.begun.recv().await, Some(1), "the request within its deadline");
    assert!(control.begun.try_recv().is_err(), "no other request was run");
    let error = StepResult::<()>::Late(None).advanced().unwrap_err();
    assert_eq!(error.kind(), Kind::Late);
}

#[tokio::test]
async fn a_free_model_waits_for_present_sessions() {
    let (engine, mut control) = engine(8, 8).await;
    drop(control.gate);
    // A part of these periods is longer than the time limit of a test, so the second request must start the batch.
    let _guards = (present(&engine, None), present(&engine, None));
    let mut first = pin!(timed(&engine, 1.0));
    assert!(poll!(&mut first).is_pending());
    // The engine's own clock begins when its thread wakes.
    let quiet = tokio::time::timeout(SOON * 10, control.begun.recv()).await;
    assert!(quiet.is_err(), "it waits");
    let (first, second) = futures::join!(first, timed(&engine, 2.0));
    assert_eq!(control.begun.recv().await, Some(2));
    assert_eq!((first.batch_size, second.batch_size), (2, 2));
    assert!(first.batch_us >= 40_000, "{first:?}");
    assert!(first.batch_us > second.batch_us, "the second did not wait for itself: {first:?} {second:?}");
}

#[tokio::test]
async fn many_sessions_are_split_into_two_micro_batches() {
    for (sessions, others, micro_batches) in
        [(4, 0, vec![4]), (5, 0, vec![4, 1]), (10, 0, vec![5, 5]), (2, 10, vec![6, 4, 2])]
    {
        let (engine, mut control) = engine(16, 16).await;
        let mut busy = pin!(engine.infer(input(0.5)));
        assert!(poll!(&mut busy).is_pending());
        assert_eq!(control.begun.recv().await, Some(1));
        // A part of these periods is longer than the time limit of a test: the model must not wait for sessions that
        // were just answered.
        let _guards: Vec<RateGuard> = (0..sessions).map(|_| present(&engine, None)).collect();
        let calls = (0..sessions + others).map(|_| engine.infer(input(1.0)));
        let mut all = pin!(futures::future::try_join_all(calls));
        assert!(poll!(&mut all).is_pending());
        drop(control.gate);
        busy.await.unwrap();
        all.await.unwrap();
        for micro_batch in micro_batches {
            assert_eq!(control.begun.recv().await, Some(micro_batch), "of {sessions} and {others}");
        }
    }
}

#[tokio::test]
async fn a_single_session_is_never_delayed() {
    let (engine, control) = engine(8, 8).await;
    drop(control.gate);
    let _guards = (present(&engine, None), engine.join(None));
    let timings = timed(&engine, 1.0).await;
    assert_eq!((timings.batch_size, timings.batch_us), (1, 0));
}

#[tokio::test]
async fn an_absent_session_delays_others_by_at_most_a_part_of_its_period() {
    let (engine, mut control) = engine(8, 8).await;
    drop(control.gate);
    let _guards = (present(&engine, None), present(&engine, Some(SOON)));
    let timings = timed(&engine, 1.0).await;
    assert_eq!(control.begun.recv().await, Some(1));
    assert!(timings.batch_us < 1_000_000, "a part of the fastest period at most: {timings:?}");
}

#[tokio::test]
async fn waiting_for_other_sessions_ends_before_a_deadline() {
    let (engine, control) = engine(8, 8).await;
    drop(control.gate);
    let _guards = (present(&engine, None), present(&engine, None));
    // From here on, the estimate of the model's time comes from a request instead of the warm-up.
    futures::join!(timed(&engine, 1.0), timed(&engine, 2.0));
    let (call, stages) = request(3.0, Some(Duration::from_secs(1)));
    let result = engine.infer_by(call).await.unwrap();
    assert!(matches!(result, StepResult::Advanced(_)), "{result:?}");
    assert_eq!(stages.timings().batch_size, 1);
}
