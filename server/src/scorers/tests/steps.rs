//! Streamed scoring, and every mistake of its clients.

use std::{sync::Arc, time::Duration};

use futures::{Stream, StreamExt as _, stream};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::super::{
    DecodedObservation, Output, Ready, Terms, score_steps,
    testing::{FAILS, Parrot, ready, seen},
};
use crate::error::{Error, Kind, Result};

type Step = Result<(DecodedObservation, Vec<f32>)>;

fn terms() -> Terms {
    Terms { idle: Duration::from_secs(60), drain: Duration::from_secs(20), stopping: CancellationToken::new() }
}

fn begin(
    ready: &Arc<Ready<Parrot>>,
    steps: impl Stream<Item = Step> + Send + Unpin + 'static,
    terms: Terms,
) -> mpsc::Receiver<Result<Output>> {
    let ready = Arc::clone(ready);
    score_steps(move || async { Ok((ready, steps)) }, terms)
}

fn steps(stamps: impl IntoIterator<Item = u8>) -> Vec<Step> {
    stamps.into_iter().map(|stamp| Ok((seen(stamp, 0.0), vec![1.0]))).collect()
}

/// A run that answers at once.
async fn quick() -> Arc<Ready<Parrot>> {
    ready().await.0
}

async fn last(mut answers: mpsc::Receiver<Result<Output>>) -> Error {
    loop {
        match answers.recv().await.unwrap() {
            Ok(_) => {}
            Err(error) => return error,
        }
    }
}

#[tokio::test]
async fn every_step_is_answered_in_order() {
    let mut answers = begin(&quick().await, stream::iter(steps(1..=40)), terms());
    for stamp in 1..=40 {
        let answer = answers.recv().await.unwrap().unwrap();
        let Output::Scored(segment) = answer else { panic!("{answer:?}") };
        assert_eq!(segment.stamp_ns, stamp);
    }
    assert!(answers.recv().await.is_none(), "it ends with its steps");
}

#[tokio::test]
async fn errors_end_the_stream() {
    let ready = quick().await;
    let none = last(begin(&ready, stream::empty(), terms())).await;
    assert!(none.kind() == Kind::Invalid && none.message().starts_with("step: "), "{none}");
    let back = last(begin(&ready, stream::iter(steps([2, 1])), terms())).await;
    assert!(back.message().starts_with("step.observation.stamp_ns: "), "{back}");
    let fails = last(begin(&ready, stream::iter([Ok((seen(1, FAILS), vec![0.0]))]), terms())).await;
    assert_eq!(fails.kind(), Kind::Internal);
    let bad = last(begin(&ready, stream::iter([Err(Error::invalid("step.action", "is bad"))]), terms())).await;
    assert_eq!(bad.kind(), Kind::Invalid);
    let never: mpsc::Receiver<Result<Output>> = score_steps(
        || async { Err::<(Arc<Ready<Parrot>>, stream::Empty<Step>), _>(Error::not_found("score run", "x")) },
        terms(),
    );
    assert_eq!(last(never).await.kind(), Kind::NotFound);
}

#[tokio::test(start_paused = true)]
async fn a_silent_or_unreading_client_loses_its_stream() {
    let ready = quick().await;
    let silent = begin(&ready, stream::iter(steps([1])).chain(stream::pending()), terms());
    assert_eq!(last(silent).await.kind(), Kind::Late);
    let unread = begin(&ready, stream::iter(steps(1..=60)), terms());
    while !unread.is_closed() && unread.len() < 17 {
        tokio::time::sleep(Duration::from_secs(10)).await;
    }
    assert_eq!(last(unread).await.kind(), Kind::Late);
}

#[tokio::test(start_paused = true)]
async fn a_run_may_load_slowly_but_not_beyond_the_server_stop() {
    let (ready, slow) = (quick().await, terms());
    let load = 10 * slow.idle;
    let start = move || async move {
        tokio::time::sleep(load).await;
        Ok((ready, stream::iter(steps([1]))))
    };
    let answer = score_steps(start, slow).recv().await.unwrap();
    assert!(matches!(answer, Ok(Output::Scored(_))), "{answer:?}");

    let ending = terms();
    let stopping = ending.stopping.clone();
    let never = score_steps::<Parrot, _, stream::Empty<Step>>(std::future::pending, ending);
    stopping.cancel();
    assert_eq!(last(never).await.kind(), Kind::Unavailable);
}

#[tokio::test(start_paused = true)]
async fn a_stopping_server_announces_and_ends_the_stream_in_time() {
    let (ready, terms) = (quick().await, terms());
    let stopping = terms.stopping.clone();
    let (sender, receiver) = mpsc::channel(4);
    let mut answers = begin(&ready, tokio_stream::wrappers::ReceiverStream::new(receiver), terms);
    stopping.cancel();
    assert!(matches!(answers.recv().await.unwrap().unwrap(), Output::Draining { .. }));
    sender.send(steps([1]).remove(0)).await.unwrap();
    assert!(matches!(answers.recv().await.unwrap().unwrap(), Output::Scored(_)), "it continues until then");
    assert_eq!(last(answers).await.kind(), Kind::Unavailable);
}
