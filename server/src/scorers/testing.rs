//! A scorer for tests that tells which steps it saw together, and fails, panics or waits on demand.

use std::sync::{Arc, Weak, mpsc};

use gleaner_learn::{EpisodeScores, SegmentScore, TaskShape, Trajectory};
use tokio::sync::mpsc as tokio_mpsc;

use super::{
    Ready, Seen, Watch,
    engine::Engine,
    model::{Followed, Scorer, Stretch},
    shelf::Shelf,
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

/// Steps of a whole segment.
pub(super) const WINDOW: usize = 3;

/// Its w of a segment is minus the stamps of its steps, each of two digits: −10203 for 1, 2, 3.
pub(super) struct Parrot {
    shape: TaskShape,
    begun: tokio_mpsc::UnboundedSender<usize>,
    gate: mpsc::Receiver<()>,
}

/// The test's side of the scorer.
pub(super) struct Control {
    /// The number of episodes in each batch as it begins.
    pub(super) begun: tokio_mpsc::UnboundedReceiver<usize>,
    /// Lets one batch end. When it is dropped, every batch ends at once.
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
        // Nobody listens, or nobody holds the gate, once the test is done with it.
        let _ = self.begun.send(stretches.len());
        let _ = self.gate.recv();
        stretches.iter().map(|stretch| one(stretch)).collect()
    }

    fn episode(&self, _: &Trajectory) -> Result<EpisodeScores> {
        Err(Error::internal("scoring", "no test asks for this"))
    }
}

fn one(stretch: &Stretch<Vec<i64>>) -> Result<Followed<Vec<i64>>> {
    let mut history = stretch.history.clone().unwrap_or_default();
    let mut scores = Vec::new();
    for step in &stretch.steps {
        match step.proprioception[0] {
            PANICS => panic!("told to"),
            FAILS => return Err(Error::internal("scoring", "told to")),
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

/// A run of the parrot on no shelf.
pub(super) async fn ready() -> (Arc<Ready<Parrot>>, Control) {
    let (ready, control) = ready_on(Weak::new()).await;
    (Arc::new(ready), control)
}

pub(super) async fn ready_on(shelf: Weak<Shelf<Parrot>>) -> (Ready<Parrot>, Control) {
    let (tell, begun) = tokio_mpsc::unbounded_channel();
    let (gate, wait) = mpsc::channel();
    let load = move || {
        let shape = TaskShape { cameras: Vec::new(), proprioception: 1, action: 1 };
        Ok(Parrot { shape, begun: tell, gate: wait })
    };
    let engine = Engine::start(&ScoreRunId::new(), load).await.unwrap();
    let task = Task { id: TaskId::new(), spec: store::testing::spec(), created_at: Millis::now() };
    (Ready { task, experts: vec![EpisodeId::new()], engine, shelf }, Control { begun, gate })
}

pub(super) fn seen(stamp: u8, proprioception: f32) -> Seen {
    Seen { stamp_ns: stamp.into(), frames: Vec::new().into(), proprioception: vec![proprioception] }
}

/// A whole step of this stamp.
pub(super) fn step(watch: &mut Watch<Parrot>, stamp: u8) {
    watch.saw(seen(stamp, 0.0));
    watch.executed(&[1.0]);
}

/// Stamps and w of everything that was scored.
pub(super) fn scored(watch: &mut Watch<Parrot>) -> Vec<(i64, f64)> {
    watch.take_scored().into_iter().map(|segment| (segment.stamp_ns, segment.w)).collect()
}
