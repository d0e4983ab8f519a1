//! Opening a session: its policy, recording and live scores, and its entries in the log.

use std::{sync::Arc, time::Duration};

use futures::{Stream, StreamExt as _};
use gleaner_learn::Policy as Model;
use tokio_util::sync::CancellationToken;
use tracing::Instrument as _;

use super::{
    Policies,
    engine::Engine,
    lock::lock,
    record::Record,
    reply_sender::{Answers, ReplySender},
    session::{Session, Terms},
};
use crate::{
    domain::{
        id::{ScoreRunId, SessionId},
        live::LiveSession,
        observation::{SessionInput, SessionSettings},
        time::Millis,
    },
    error::{Error, Kind, Result},
    rollouts::SessionInfo,
    scorers::Watch,
};

impl Policies {
    /// Starts a session, opened by its first input. Outputs are read from the receiver; an error is the last one.
    pub(crate) fn session(
        &self,
        inputs: impl Stream<Item = Result<SessionInput>> + Send + Unpin + 'static,
        stopping: CancellationToken,
    ) -> Answers {
        let (replies, answers) = ReplySender::new(self.0.config.policies.session_idle());
        let policies = self.clone();
        tokio::spawn(async move {
            let ended = policies.open_session(inputs, &replies, &stopping).await;
            // Policies held only by this session may be unloaded.
            lock(&policies.0.loaded).make_room(0);
            if let Err(error) = ended {
                replies.fail(error);
            }
        });
        answers
    }

    async fn open_session(
        &self,
        mut inputs: impl Stream<Item = Result<SessionInput>> + Send + Unpin,
        replies: &ReplySender,
        stopping: &CancellationToken,
    ) -> Result<()> {
        let idle = self.0.config.policies.session_idle();
        let first = tokio::select! {
            first = inputs.next() => first,
            () = tokio::time::sleep(idle) => return Err(Error::late("no `open` message was received in time; open the session again")),
            () = replies.closed() => return Ok(()),
            () = stopping.cancelled() => return Err(Error::unavailable("the server is stopping; retry")),
        };
        let Some(SessionInput::Open(settings)) = first.transpose()? else {
            return Err(Error::invalid("open", "must be the first message of a session"));
        };
        let session = self.begin(settings).await?;
        let Terms { id, settings, .. } = session.terms();
        let span = tracing::info_span!(
            "session", session.id = %id, deployment.name = %settings.deployment,
            policy.id = %session.policy_id(), control.rate_hz = settings.control_rate_hz.unwrap_or(0.0)
        );
        async {
            tracing::debug!("session opened");
            let ended = session.run(inputs, replies, stopping).await;
            match &ended {
                Ok(()) => tracing::debug!("session closed"),
                Err(error) if error.kind() == Kind::Cancelled => tracing::debug!(%error, "session cancelled"),
                Err(error) => tracing::info!(%error, "session failed"),
            }
            ended
        }
        .instrument(span)
        .await
    }

    /// A session with its policy, its recorder and its live scorer.
    async fn begin(&self, settings: SessionSettings) -> Result<Session<Model>> {
        let SessionSettings { deployment, control_rate_hz, record, .. } = &settings;
        let (engine, score_run) = self.pointed(deployment).await?;
        let watch = self.watch(deployment, score_run.as_ref()).await?;
        let id = SessionId::new();
        let recorder = match record {
            None => None,
            Some(cohort) => {
                let identity = engine.identity();
                let task = self.0.store.task_by_id(&identity.task_id).await?;
                let info = SessionInfo {
                    session_id: id.clone(),
                    task_id: identity.task_id.clone(),
                    deployment: deployment.clone(),
                    policy_id: identity.policy_id.clone(),
                    score_run_id: score_run,
                    control_rate_hz: control_rate_hz.unwrap_or(task.spec.rate_hz),
                    cohort: cohort.clone(),
                };
                Some(self.0.rollouts.begin(info, &task)?)
            }
        };
        let showing = self.0.live.begin(LiveSession {
            id: id.clone(),
            deployment: deployment.clone(),
            policy_id: engine.identity().policy_id.clone(),
            task_id: engine.identity().task_id.clone(),
            since: Millis::now(),
            recorded: recorder.is_some(),
        });
        let idle = self.0.config.policies.session_idle();
        let terms = Terms { id, settings, idle, drain: Duration::from_secs(self.0.config.drain_seconds) };
        Ok(Session::new(engine, terms, Record::new(recorder, showing), watch))
    }

    /// The policy and the score run of a deployment, both from one moment.
    async fn pointed(&self, name: &str) -> Result<(Arc<Engine<Model>>, Option<ScoreRunId>)> {
        let engine = self.deployed(name).await?;
        let deployment = self.0.store.deployment(name).await?;
        let now = deployment.assignment().map(|now| (now.policy_id.clone(), now.hide_history));
        if now == Some(engine.identity().key()) {
            return Ok((engine, deployment.score_run_id().cloned()));
        }
        // The deployment was moved meanwhile, or a move was stored without reaching memory. Under the lock, the stored
        // row is current.
        let _moving = self.0.moving.lock().await;
        let (engine, deployment) = self.as_stored(name).await?;
        Ok((engine, deployment.score_run_id().cloned()))
    }

    async fn watch(&self, deployment: &str, score_run: Option<&ScoreRunId>) -> Result<Option<Watch>> {
        let Some(run) = score_run else { return Ok(None) };
        match self.0.scorers.load(run).await {
            Ok(ready) => Ok(Some(ready.watch())),
            Err(error) => {
                tracing::warn!(
                    %error, deployment.name = deployment, score_run.id = %run,
                    "a deployment's score run cannot be loaded"
                );
                Err(error)
            }
        }
    }
}
