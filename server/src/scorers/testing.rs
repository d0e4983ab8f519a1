//! A scorer for tests that encodes the scored steps in w and fails, panics or waits on demand.

use std::sync::{Arc, Weak, mpsc};

use gleaner_learn::{EpisodeScores, SegmentScore, TaskShape, Trajectory};
use tokio::sync::mpsc as tokio_mpsc;

use super::{
    DecodedObservation, Ready, Watch,
    engine::Engine,
    loaded_runs::LoadedRuns,
    model::{Followed, Scorer, Stretch},
};
use crate::{
    domain::{
        id::{EpisodeId, ScoreRunId, TaskId},
        task::Task,
        time::Millis,
    },
    error::{Error, Result},
    store,
};

/// Proprioceptions at which the scorer panics and fails.
pub(super) const PANICS: f32 = 666.0;
pub(super) const FAILS: f32 = 667.0;

/// The steps of a whole segment.
pub(super) const WINDOW: usize = 3;

/// w of a segment is minus the stamps of its steps, two digits each: −10203 for 1, 2, 3.
pub(super) struct Parrot {
    shape: TaskShape,
    begun: tokio_mpsc::UnboundedSender<usize>,
    gate: mpsc::Receiver<()>,
}

/// The test's side of the scorer.
pub(super) struct Control {
    /// The number of episodes in each batch at its start.
    pub(super) begun: tokio_mpsc::UnboundedReceiver<usize>,
    /// Releases one batch. When it is dropped, every batch ends at once.
    pub(super) gate: mpsc::Sender<()>,
}

impl Scorer for Parrot {
    type History = Vec<i64>;

    fn shape(&self) -> &TaskShape {
        &self.shape
    }

    fn window(&self) -> usize {
        WINDOW
    }

    fn follow(&self, stretches: &[&Stretch<Vec<i64>>]) -> Result<Vec<Followed<Vec<i64>>>> {
        // Both channels are closed once the test is done with them.
        let _ = self.begun.send(stretches.len());
        let _ = self.gate.recv();
        stretches.iter().map(|stretch| one(stretch)).collect()
    }

    fn episode(&self, _: &Trajectory) -> Result<EpisodeScores> {
        Err(Error::internal("scoring", "not supported by this double"))
    }
}

fn one(stretch: &Stretch<Vec<i64>>) -> Result<Followed<Vec<i64>>> {
    let mut history = stretch.history.clone().unwrap_or_default();
    let mut scores = Vec::new();
    for step in &stretch.steps {
        match step.proprioception[0] {
            PANICS => panic!("on demand"),
            FAILS => return Err(Error::internal("scoring", "on demand")),
            _ => {}
        }
        if step.begins {
            history.clear();
        }
        if history.len() == WINDOW {
            history.remove(0);
        }
        history.push(step.stamp_ns);
        if step.scored {
            let digits = history.iter().fold(0, |digits, stamp| digits * 100 + stamp);
            let w = -f64::from(i32::try_from(digits).unwrap());
            scores.push(SegmentScore { w, q: 0.5, match_episode: 0, match_step: 7, distances: [0.0; 3] });
        }
    }
    Ok(Followed { history: Some(history), scores })
}

/// A loaded run outside any cache.
pub(super) async fn ready() -> (Arc<Ready<Parrot>>, Control) {
    let (ready, control) = ready_in(Weak::new()).await;
    (Arc::new(ready), control)
}

pub(super) async fn ready_in(loaded: Weak<LoadedRuns<Parrot>>) -> (Ready<Parrot>, Control) {
    let (begun_sender, begun) = tokio_mpsc::unbounded_channel();
    let (gate, wait) = mpsc::channel();
    let load = move || {
        let shape = TaskShape {
            cameras: Vec::new(),
            proprioception: 1,
            action: 1,
            ranges: gleaner_core::action::ActionRanges::default(),
        };
        Ok(Parrot { shape, begun: begun_sender, gate: wait })
    };
    let engine = Engine::start(&ScoreRunId::new(), load).await.unwrap();
    let task = Task { id: TaskId::new(), spec: store::testing::spec(), created_at: Millis::now() };
    (Ready { task, experts: vec![EpisodeId::new()], engine, loaded }, Control { begun, gate })
}

pub(super) fn seen(stamp: u8, proprioception: f32) -> DecodedObservation {
    DecodedObservation { stamp_ns: stamp.into(), frames: Vec::new().into(), proprioception: vec![proprioception] }
}

/// A whole step of this stamp.
pub(super) fn step(watch: &mut Watch<Parrot>, stamp: u8) {
    watch.saw(seen(stamp, 0.0));
    watch.executed(&[1.0]);
}

/// Stamps and w of all scores.
pub(super) fn scored(watch: &mut Watch<Parrot>) -> Vec<(i64, f64)> {
    watch.take_scored().into_iter().map(|segment| (segment.stamp_ns, segment.w)).collect()
}
