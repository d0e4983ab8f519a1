//! The engine of a Slurm cluster: each worker is a Slurm job, which outlives the server. Slurm's states report only what
//! the worker itself cannot: that it has not started, and that it is gone. Must not depend on rows.

mod cancel;
mod commands;
mod output;
mod poller;
mod script;
mod state;
mod submit;
#[cfg(test)]
mod tests;

use std::{path::Path, sync::Arc, time::Duration};

use async_trait::async_trait;
use tokio::{io::DuplexStream, sync::watch, time::Instant};

use self::{
    commands::{Commands, Entry},
    output::Following,
    poller::{Poller, Snapshot, View},
    script::{Submission, Template},
    state::State,
};
use super::{End, Engine, Execution, Launch, Output};
use crate::{
    config::{ServeConfig, cluster_environment},
    domain::{attempt::Attempt, placement::Placement},
    error::{Error, Result},
    jobs::lease::Lease,
    program::Program,
};

/// Longest time from the delivery of a result until the Slurm job is cancelled.
const GRACE: Duration = Duration::from_secs(30);
/// Answers of squeue without an attempt's job after which the job is gone: the controller lists a new job at once.
const MISSED: u32 = 2;

/// The engine.
pub(in crate::jobs) struct Slurm {
    commands: Commands,
    poller: Poller,
    template: Template,
}

impl Slurm {
    pub(in crate::jobs) const NAME: &'static str = "slurm";

    /// # Errors
    /// Precondition when a file that a flag names cannot be read.
    pub(in crate::jobs) fn new(config: Arc<ServeConfig>) -> Result<Self> {
        let engine = &config.jobs.engine;
        let encrypted = config.access.tls_cert.is_some();
        let missing = || Error::precondition("--engine slurm: set --worker-listen");
        let url = engine.url(encrypted).ok_or_else(missing)?;
        let authority = engine.worker_ca.as_deref().map(pem).transpose()?;
        let data_dir = std::path::absolute(&config.data_dir)
            .map_err(|error| Error::precondition(format!("--data-dir {}: {error}", config.data_dir.display())))?;
        let worker = match &engine.slurm.slurm_worker {
            Some(path) => path.clone(),
            None => Program::Worker.path()?,
        };
        let commands = Commands::new(engine.slurm.slurm_bin.clone(), cluster_environment());
        let poller = Poller::start(commands.clone(), Duration::from_secs(engine.slurm.slurm_poll_seconds));
        Ok(Self { commands, poller, template: Template { config, data_dir, worker, url, authority } })
    }

    fn execution(&self, attempt: &Attempt, lease: &Arc<Lease>, from: From, placement: Placement) -> SlurmJob {
        let name = script::name(attempt);
        let (following, output) = Following::start(self.template.output(&name));
        SlurmJob {
            commands: self.commands.clone(),
            poller: self.poller.clone(),
            view: self.poller.view(&name),
            following,
            output: Some(output),
            name,
            lease: Arc::clone(lease),
            from,
            shared: false,
            placement: watch::Sender::new(placement),
        }
    }
}

fn pem(path: &Path) -> Result<String> {
    let wrong = |problem: String| Error::precondition(format!("--worker-ca {}: {problem}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    if text.contains("-----BEGIN CERTIFICATE-----") {
        Ok(text)
    } else {
        Err(wrong("not a certificate in PEM form".into()))
    }
}

impl Engine for Slurm {
    fn name(&self) -> &'static str {
        Self::NAME
    }

    fn outlives_server(&self) -> bool {
        true
    }

    fn takes_options(&self) -> bool {
        true
    }

    fn start(&self, launch: Launch<'_>) -> std::result::Result<Box<dyn Execution>, String> {
        let from = From::Submission(Box::new(self.template.submission(&launch)));
        let placement = Placement { engine: Self::NAME.to_owned(), ..Placement::default() };
        let shared = self.template.config.jobs.ranks.of(&launch.job.spec) > 1;
        Ok(Box::new(SlurmJob { shared, ..self.execution(launch.attempt, launch.lease, from, placement) }))
    }

    fn resume(&self, attempt: &Attempt, placement: &Placement, lease: &Arc<Lease>) -> Option<Box<dyn Execution>> {
        if placement.engine != Self::NAME {
            return None;
        }
        Some(Box::new(self.execution(attempt, lease, From::EarlierServer, placement.clone())))
    }
}

/// Where a Slurm job comes from.
enum From {
    /// It is to be submitted.
    Submission(Box<Submission>),
    /// A server that has ended submitted it, or ended just before.
    EarlierServer,
}

/// The Slurm job of one attempt.
struct SlurmJob {
    commands: Commands,
    poller: Poller,
    view: View,
    /// Reads the output; ends with the worker.
    following: Following,
    output: Option<DuplexStream>,
    name: String,
    lease: Arc<Lease>,
    from: From,
    /// Whether the job has several ranks, as far as this server knows.
    shared: bool,
    placement: watch::Sender<Placement>,
}

#[async_trait]
impl Execution for SlurmJob {
    fn placement(&self) -> watch::Receiver<Placement> {
        self.placement.subscribe()
    }

    fn output(&mut self) -> Option<Output> {
        self.output.take().map(|output| Box::new(output) as Output)
    }

    async fn ended(&mut self) -> End {
        if matches!(self.from, From::Submission(_)) {
            self.submit().await;
        }
        let delivered = self.lease.delivered.clone();
        let end = tokio::select! {
            end = self.follow() => end,
            // A worker that has delivered its result and does not end is cancelled.
            () = async { delivered.cancelled().await; tokio::time::sleep(GRACE).await } => {
                self.cancel();
                End::Broken("the worker did not end after its result".to_owned())
            }
        };
        self.following.end();
        end
    }

    async fn kill(&mut self, reason: String) -> End {
        self.cancel();
        self.following.end();
        // A worker on another machine is silent when the machine or the network fails, and the job is not at fault.
        End::Interrupted(reason)
    }
}

impl SlurmJob {
    /// Follows the Slurm job to its end.
    async fn follow(&mut self) -> End {
        let (mut since, mut missed, mut seen) = (Instant::now(), 0, false);
        loop {
            let (asked_at, snapshot) = self.answer_after(since).await;
            since = asked_at;
            let Some(entry) = snapshot.entry(&self.name) else {
                missed += 1;
                if missed >= MISSED && !self.lease.contested() {
                    return self.gone(seen);
                }
                continue;
            };
            missed = 0;
            self.record(entry);
            let delivered = self.lease.delivered.is_cancelled();
            let begun = matches!(self.from, From::EarlierServer) || self.lease.begun();
            match state::end(entry, begun) {
                // A second process of this attempt was rejected, and Slurm's view may be of that one. The first one's
                // reports, or their absence, decide.
                Some(_) if self.lease.contested() && !delivered => {}
                Some(end) => return self.of_this_server(end, seen),
                None if delivered && State::of(entry) == State::Completing => {
                    return End::Broken("the worker has delivered its result".to_owned());
                }
                None => seen = true,
            }
        }
    }

    /// The next answer of squeue after `since`, sooner once the worker has delivered its result.
    async fn answer_after(&mut self, since: Instant) -> (Instant, Snapshot) {
        let (delivered, placement, poller) =
            (self.lease.delivered.clone(), self.placement.clone(), self.poller.clone());
        let answer = self.view.after(since, |problem| {
            placement.send_if_modified(|placement| {
                let worker_runs = !placement.node.is_empty();
                !worker_runs && replace(&mut placement.waiting, problem)
            });
        });
        if delivered.is_cancelled() {
            return answer.await;
        }
        tokio::pin!(answer);
        tokio::select! {
            answer = &mut answer => answer,
            () = delivered.cancelled() => {
                poller.hurry();
                answer.await
            }
        }
    }

    /// The end of a job that ended as `end`. One that ended while no server watched may have ended for want of a server.
    fn of_this_server(&self, end: End, seen: bool) -> End {
        match (&self.from, end) {
            (From::EarlierServer, End::Broken(reason) | End::Stopped(reason)) if !seen => {
                End::Interrupted(format!("{reason}, while the server was down"))
            }
            // When a node or a rank fails, the other ranks end too, and Slurm reports a failed job. It is no fault of the
            // job, which resumes if it saved a checkpoint.
            (From::EarlierServer | From::Submission(_), End::Broken(reason)) if self.shared => End::Stopped(reason),
            (From::EarlierServer | From::Submission(_), end) => end,
        }
    }

    /// The end of a job that Slurm does not list.
    fn gone(&self, seen: bool) -> End {
        let id = self.placement.borrow().engine_id.clone();
        match &self.from {
            From::EarlierServer if id.is_empty() => {
                End::Interrupted("the server stopped before the job was submitted to Slurm".to_owned())
            }
            From::EarlierServer if !seen => End::Interrupted(format!("Slurm job {id} ended while the server was down")),
            // A controller that is killed can forget what it has listed as waiting. A job that is never listed counts, so that
            // a wrong option of squeue's view does not submit without an end.
            from if seen && self.only_waited(from) => {
                End::Interrupted(format!("Slurm forgot job {id}, which had only waited"))
            }
            From::EarlierServer | From::Submission(_) => {
                End::Broken(format!("Slurm job {id} has ended, and Slurm has no record of how"))
            }
        }
    }

    /// Whether this server has seen the job wait, and not run. The lease of a resumed attempt begins with it.
    fn only_waited(&self, from: &From) -> bool {
        let begun = matches!(from, From::Submission(_)) && self.lease.begun();
        !begun && self.placement.borrow().node.is_empty()
    }

    /// Records where the job is.
    fn record(&self, entry: &Entry) {
        let waits = State::of(entry) == State::Waiting;
        let reason = if entry.reason.is_empty() { "Slurm has not started it" } else { &entry.reason };
        let waiting = if waits { reason } else { "" };
        self.placement.send_if_modified(|placement| {
            // Each part is compared and replaced.
            replace(&mut placement.engine_id, &entry.id)
                | (!entry.node.is_empty() && replace(&mut placement.node, &entry.node))
                | replace(&mut placement.waiting, waiting)
        });
    }
}

/// Replaces a text; returns whether it differed.
fn replace(text: &mut String, new: &str) -> bool {
    let differs = text != new;
    if differs {
        new.clone_into(text);
    }
    differs
}
