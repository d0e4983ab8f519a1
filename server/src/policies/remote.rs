//! Policies that other servers run: their engines, whose requests are answered by tasks. No thread waits for such a server,
//! and a slow one delays its own sessions alone.

use std::sync::Arc;

use gleaner_core::ensemble::Execution;
use gleaner_learn::{Policy as Model, TaskShape};
use gleaner_remote::{Hosts, Outgoing, Remote, Step};
use tokio::{sync::Semaphore, task::JoinSet};

use super::{
    Policies,
    batch::{QueuedRequest, StepResult},
    engine::{Engine, Identity},
    model::{Advanced, History, ModelInput},
    remote_history::RemoteHistory,
};
use crate::{
    config::PolicyServersConfig,
    domain::{policy::Policy, remote::RemotePolicy, task::Task},
    error::{Error, Kind, Result},
};

/// The operator's rules for calls of other servers.
pub(super) fn outgoing(config: &PolicyServersConfig) -> Outgoing {
    let PolicyServersConfig { policy_servers, policy_server_tokens, policy_server_ca } = config;
    Outgoing {
        // The server does not start with other entries.
        hosts: Hosts::parse(policy_servers).unwrap_or_default(),
        tokens: policy_server_tokens.clone(),
        ca: policy_server_ca.clone(),
    }
}

impl Policies {
    /// Registers a policy that another server runs. Does not connect to it.
    ///
    /// # Errors
    /// Invalid, naming the field; Precondition when the server may not connect to that host.
    pub(crate) async fn register(&self, task: &Task, remote: RemotePolicy) -> Result<Policy> {
        let remote = remote.checked(&task.spec)?;
        Remote::new(remote.clone(), &task.spec, self.0.outgoing.clone())?;
        let policy = self.0.store.register_policy(&task.id, remote).await?;
        tracing::info!(policy.id = %policy.id, "policy of another server registered");
        Ok(policy)
    }

    /// Has the server of a remote policy answer a blank observation, as a trained policy does when it is loaded. Takes as
    /// long as that server.
    ///
    /// # Errors
    /// Unavailable when it does not answer; Precondition when it may not be called, or its answer cannot be used.
    pub(super) async fn check(&self, policy: &Policy, hide_history: bool) -> Result<()> {
        let Some(remote) = policy.remote() else { return Ok(()) };
        expect_shown(hide_history)?;
        self.remote(remote, &self.0.store.task_by_id(&policy.task_id).await?)?.check().await
    }

    /// The server of a policy, under the present rules.
    ///
    /// # Errors
    /// Precondition when the server may not connect to its host.
    pub(super) fn remote(&self, policy: &RemotePolicy, task: &Task) -> Result<Arc<Remote>> {
        Ok(Arc::new(Remote::new(policy.clone(), &task.spec, self.0.outgoing.clone())?))
    }
}

/// An engine for a policy of another server.
///
/// # Errors
/// Invalid when the history is to be hidden, which only the other server could do.
pub(super) fn engine(identity: Identity, remote: Arc<Remote>, horizon: u32, task: &Task) -> Result<Arc<Engine<Model>>> {
    expect_shown(identity.hide_history)?;
    let (shape, execution) = (TaskShape::from(&task.spec), Execution::of_horizon(horizon));
    let most = identity.queue.max(1);
    let calls = Arc::new(Calls { remote, shape: shape.clone(), execution });
    let (engine, waiting) = Engine::of_task(identity, (shape, 1, execution));
    tokio::spawn(serve(calls, waiting, most));
    Ok(engine)
}

/// Another server alone could hide the history of its policy.
fn expect_shown(hide_history: bool) -> Result<()> {
    if hide_history {
        return Err(Error::invalid("hide_history", "needs a policy that was trained on this server; leave it out"));
    }
    Ok(())
}

/// What every call of one engine needs.
struct Calls {
    remote: Arc<Remote>,
    shape: TaskShape,
    execution: Execution,
}

/// Answers requests, at most `most` at once, until the last handle of the engine is dropped.
async fn serve(calls: Arc<Calls>, waiting: flume::Receiver<QueuedRequest<History>>, most: usize) {
    let (places, mut running) = (Arc::new(Semaphore::new(most)), JoinSet::new());
    while let Ok(request) = waiting.recv_async().await {
        let Ok(place) = Arc::clone(&places).acquire_owned().await else { break };
        while running.try_join_next().is_some() {}
        let calls = Arc::clone(&calls);
        running.spawn(async move {
            let _place = place;
            answer(&calls, request).await;
        });
    }
    // Calls have time limits.
    while running.join_next().await.is_some() {}
}

/// Answers one request. A caller that is gone ends the call.
async fn answer(calls: &Calls, request: QueuedRequest<History>) {
    let QueuedRequest { input, stages, deadline, since: _, mut reply } = request;
    // Below, a caller that is gone needs no reply.
    if deadline.is_some_and(|deadline| deadline <= std::time::Instant::now()) {
        let _ = reply.send(Ok(StepResult::Late(input.history)));
        return;
    }
    let ModelInput { history, begin, skipped, steps } = input;
    let before = match history {
        Some(History::Remote(history)) => Some(history),
        // A session keeps its engine, so there is no other history.
        Some(History::Trained(_)) | None => None,
    };
    let Some(newest) = steps.last() else { return };
    let passed = skipped.saturating_add(steps.len() as u64);
    let step =
        Step { frame: &newest.frame, proprioception: &newest.proprioception, executed: newest.executed.as_deref() };
    let new = || RemoteHistory::new(&calls.remote, &calls.shape, begin.execution(calls.execution));
    let mut now = before.clone().unwrap_or_else(new);
    stages.enters(std::time::Duration::ZERO, 1);
    let advanced = tokio::select! {
        advanced = now.advance(&calls.shape, passed, &step) => advanced,
        () = reply.closed() => return,
    };
    stages.leaves();
    let _ = reply.send(match advanced {
        Ok(actions) => Ok(StepResult::Advanced(Advanced { history: History::Remote(now), actions })),
        Err(error) if error.kind() == Kind::Unavailable => {
            Ok(StepResult::Unanswered(before.map(History::Remote), error))
        }
        Err(error) => Err(error),
    });
}
