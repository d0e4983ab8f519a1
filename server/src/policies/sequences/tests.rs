//! Sequences with a model that echoes its history.

use std::pin::pin;

use futures::poll;

use super::{
    super::testing::{Parrot, TestEngine, engine, observation},
    *,
};
use crate::error::Kind;

/// One deployment and its clients.
struct Desk {
    sequences: Sequences<Parrot>,
    engine: Arc<TestEngine>,
}

impl Desk {
    fn request(&self, deployment: &str, id: u64, start: bool, end: bool) -> Result<SequenceCall<Parrot>> {
        let place = Place { id: SequenceId::Number(id), start, end };
        if start {
            return Ok(self.sequences.fresh(deployment, Arc::clone(&self.engine), Some(place)));
        }
        self.sequences.running(deployment, place)
    }

    async fn starts(&self, id: u64, number: u8) -> Vec<f32> {
        let request = self.request("arm", id, true, false).unwrap();
        request.act("inputs", observation(number, &[])).await.unwrap().remove(0)
    }

    async fn continues(&self, id: u64, sees: Observation) -> Result<Vec<f32>> {
        Ok(self.request("arm", id, false, false)?.act("inputs", sees).await?.remove(0))
    }

    fn count(&self) -> usize {
        lock(&self.sequences.0).slots.len()
    }
}

/// A desk whose model answers at once.
async fn desk() -> Desk {
    let (engine, control) = engine(8, 8).await;
    drop(control);
    Desk { sequences: Sequences::default(), engine }
}

#[tokio::test]
async fn sequences_keep_separate_histories() {
    let desk = desk().await;
    // Before the first observation no action can have been executed.
    let first = desk.request("arm", 1, true, false).unwrap();
    assert_eq!(first.act("inputs", observation(1, &[50.0, 0.0])).await.unwrap(), [[1.0, 0.0]]);
    assert_eq!(desk.continues(1, observation(2, &[])).await.unwrap(), [2.0, 1.0], "the given action was executed");
    assert_eq!(desk.starts(2, 9).await, [9.0, 0.0]);
    assert_eq!(
        desk.continues(1, observation(3, &[10.0, 0.0])).await.unwrap(),
        [3.0, 11.0],
        "unless the client sends another"
    );

    let elsewhere = desk.request("other", 1, false, false).err().unwrap();
    assert!(elsewhere.message().starts_with("parameters.sequence_id: "), "{elsewhere}");
    let alone = desk.sequences.fresh("arm", Arc::clone(&desk.engine), None);
    assert_eq!(alone.act("inputs", observation(4, &[7.0, 0.0])).await.unwrap(), [[4.0, 0.0]]);
    assert_eq!(desk.starts(1, 5).await, [5.0, 0.0], "a start resets the history");
    assert_eq!(desk.continues(1, observation(6, &[])).await.unwrap(), [6.0, 5.0]);
}

#[tokio::test]
async fn an_end_is_answered_and_the_sequence_is_removed() {
    let desk = desk().await;
    desk.starts(1, 1).await;
    let waits = desk.request("arm", 1, false, false).unwrap();
    let last = desk.request("arm", 1, false, true).unwrap();
    assert_eq!(last.act("inputs", observation(2, &[])).await.unwrap(), [[2.0, 1.0]]);
    assert_eq!(desk.continues(1, observation(3, &[])).await.unwrap_err().kind(), Kind::Invalid);
    let late = waits.act("inputs", observation(3, &[])).await.unwrap_err();
    assert_eq!(late.kind(), Kind::Invalid, "also for one that was waiting");
    let short = desk.request("arm", 1, true, true).unwrap();
    assert_eq!(short.act("inputs", observation(4, &[])).await.unwrap(), [[4.0, 0.0]]);
    assert_eq!(desk.count(), 0);
}

#[tokio::test]
async fn a_request_that_fails_or_is_cancelled_leaves_its_sequence_unchanged() {
    let (engine, mut control) = engine(8, 8).await;
    let desk = Desk { sequences: Sequences::default(), engine };
    control.gate.send(()).unwrap();
    desk.starts(1, 1).await;
    control.begun.recv().await.unwrap();
    let mut bad = observation(2, &[]);
    bad.proprioception = vec![f32::NAN];
    let error = desk.continues(1, bad.clone()).await.unwrap_err();
    assert!(error.message().starts_with("inputs.proprioception[0]: "), "{error}");
    let never = desk.request("arm", 2, true, false).unwrap();
    never.act("inputs", bad).await.unwrap_err();
    assert_eq!(desk.count(), 1, "a failed start adds no sequence");
    {
        let mut gone = pin!(desk.continues(1, observation(3, &[])));
        while control.begun.try_recv().is_err() {
            assert!(poll!(&mut gone).is_pending());
            tokio::task::yield_now().await;
        }
    }
    drop(control.gate);
    assert_eq!(desk.continues(1, observation(4, &[])).await.unwrap(), [4.0, 1.0]);
}

#[tokio::test]
async fn a_new_sequence_replaces_the_longest_idle() {
    let desk = desk().await;
    let most = u64::try_from(MOST).unwrap();
    for id in 1..=most {
        desk.starts(id, 1).await;
    }
    desk.continues(1, observation(2, &[])).await.unwrap();
    let busy = desk.request("arm", 2, false, false).unwrap();
    desk.starts(most + 1, 1).await;
    assert_eq!(desk.count(), MOST);
    assert!(desk.request("arm", 1, false, false).is_ok(), "was used since");
    assert!(desk.request("arm", 3, false, false).is_err(), "the longest idle");
    busy.act("inputs", observation(2, &[])).await.unwrap();

    let held: Vec<_> =
        (1..=most + 1).filter(|&id| id != 3).map(|id| desk.request("arm", id, false, false).unwrap()).collect();
    let more = desk.request("arm", 0, true, false).unwrap();
    assert_eq!(more.act("inputs", observation(1, &[])).await.unwrap_err().kind(), Kind::Exhausted);
    let other = desk.request("other", 1, true, false).unwrap();
    other.act("inputs", observation(1, &[])).await.unwrap();
    assert_eq!((held.len(), desk.count()), (MOST, MOST + 1), "the limit holds per deployment");
}

#[tokio::test]
async fn idle_sequences_are_removed_in_time() {
    let desk = desk().await;
    desk.starts(1, 1).await;
    tokio::time::pause();
    tokio::time::advance(IDLE - SWEEP).await;
    desk.continues(1, observation(2, &[])).await.unwrap();
    tokio::time::advance(IDLE - SWEEP).await;
    assert_eq!(desk.count(), 1, "used since");
    tokio::time::advance(SWEEP * 2).await;
    tokio::task::yield_now().await;
    assert_eq!((desk.count(), lock(&desk.sequences.0).swept), (0, false), "without any request");
    assert_eq!(Arc::strong_count(&desk.engine), 1, "and its policy can be unloaded");
}
