//! A model for tests that echoes its inputs and fails, panics or waits on demand.

use std::{
    cell::Cell,
    sync::{Arc, mpsc},
    time::Duration,
};

use gleaner_learn::TaskShape;
use tokio::sync::mpsc as tokio_mpsc;

use super::{
    engine::{Engine, Identity},
    model::{Advanced, Begin, Model, ModelInput, Step},
};
use crate::{
    domain::{
        id::{PolicyId, TaskId},
        observation::Observation,
    },
    error::{Error, Result},
};

/// Proprioceptions at which the model panics, fails, and returns NaN.
pub(super) const PANICS: f32 = 666.0;
pub(super) const FAILS: f32 = 667.0;
pub(super) const GIVES_NAN: f32 = 668.0;
/// A proprioception whose answer needs no pass.
pub(super) const HELD: f32 = 669.0;

/// The contribution of each skipped step to the action.
pub(super) const SKIP: f32 = 1000.0;

/// The contribution of a step that continues a history after an unknown action, which a window of one step permits.
pub(super) const UNKNOWN: f32 = 0.5;

/// Acts with the newest proprioception and the sum of the executed actions' first values.
pub(super) struct Parrot {
    shape: TaskShape,
    window: usize,
    warm: Cell<bool>,
    begun: tokio_mpsc::UnboundedSender<usize>,
    gate: mpsc::Receiver<()>,
}

/// The test's side of the model.
pub(super) struct Control {
    /// The size of each batch at its start; the warm-up is not reported.
    pub(super) begun: tokio_mpsc::UnboundedReceiver<usize>,
    /// Releases one batch. When it is dropped, every batch ends at once.
    pub(super) gate: mpsc::Sender<()>,
}

/// The engine of the tests.
pub(super) type TestEngine = Engine<Parrot>;

impl Model for Parrot {
    /// The newest proprioception, and every executed action's first value.
    type History = (f32, Vec<f32>);

    fn shape(&self) -> &TaskShape {
        &self.shape
    }

    fn window(&self) -> usize {
        self.window
    }

    fn predicts(&self, input: &ModelInput<Self::History>) -> bool {
        input.steps.iter().all(|step| step.proprioception != [HELD])
    }

    fn advance(&self, inputs: &[&ModelInput<Self::History>]) -> Result<Vec<Advanced<Self::History>>> {
        if self.warm.replace(true) {
            // Both channels are closed once the test is done with them.
            let _ = self.begun.send(inputs.len());
            let _ = self.gate.recv();
        }
        inputs.iter().map(|input| self.one(input)).collect()
    }
}

impl Parrot {
    fn one(&self, input: &ModelInput<(f32, Vec<f32>)>) -> Result<Advanced<(f32, Vec<f32>)>> {
        let unknown = input.history.is_some() && input.steps[0].executed.is_none();
        // As a policy with a history does.
        if unknown && self.window > 1 {
            return Err(Error::invalid("executed", "is unknown"));
        }
        let mut history = input.history.clone().unwrap_or_default();
        history.1.extend(unknown.then_some(UNKNOWN));
        let skipped = u8::try_from(input.skipped).unwrap();
        for step in &input.steps {
            history.0 = step.proprioception[0];
            history.1.extend(step.executed.as_ref().map(|action| action[0]));
        }
        let newest = match history.0 {
            PANICS => panic!("on demand"),
            FAILS => return Err(Error::internal("acting", "on demand")),
            GIVES_NAN => f32::NAN,
            newest => newest,
        };
        let executed: f32 = history.1.iter().sum();
        let sum = executed + SKIP * f32::from(skipped);
        Ok(Advanced { history, actions: vec![vec![newest, sum]] })
    }
}

/// Starts an engine with these limits.
pub(super) async fn engine(batch: usize, queue: usize) -> (Arc<TestEngine>, Control) {
    engine_of_window(3, batch, queue).await
}

/// The same, whose model reads this many steps.
pub(super) async fn engine_of_window(window: usize, batch: usize, queue: usize) -> (Arc<TestEngine>, Control) {
    let (begun_sender, begun) = tokio_mpsc::unbounded_channel();
    let (gate, wait) = mpsc::channel();
    let engine = Engine::start(identity(batch, queue), move || {
        let shape = TaskShape {
            cameras: Vec::new(),
            proprioception: 1,
            action: 2,
            ranges: gleaner_core::action::ActionRanges::default(),
        };
        Ok(Parrot { shape, window, warm: Cell::new(false), begun: begun_sender, gate: wait })
    });
    (engine.await.unwrap(), Control { begun, gate })
}

pub(super) fn identity(batch: usize, queue: usize) -> Identity {
    let (policy_id, task_id) = (PolicyId::new(), TaskId::new());
    Identity {
        policy_id,
        hide_history: false,
        task_id,
        batch,
        queue,
        period: Duration::from_secs(1000),
        wait: 0.05,
        spin: Duration::ZERO,
    }
}

/// A first input with this proprioception.
pub(super) fn input(proprioception: f32) -> ModelInput<(f32, Vec<f32>)> {
    let step = Step { frame: Vec::new(), proprioception: vec![proprioception], executed: None };
    ModelInput { history: None, begin: Begin::default(), skipped: 0, steps: vec![step] }
}

/// An observation with this number as stamp and proprioception.
pub(super) fn observation(number: u8, executed_action: &[f32]) -> Observation {
    Observation {
        stamp_ns: i64::from(number),
        cameras: Vec::new(),
        proprioception: vec![f32::from(number)],
        executed_action: executed_action.to_vec(),
        deadline: None,
        skipped_steps: 0,
    }
}
