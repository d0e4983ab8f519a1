//! The load: eight clients that push, and one each that runs jobs, records sessions and curates. Each resumes once the
//! server is back; an unexpected response fails the test.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use bytes::Bytes;
use futures::{StreamExt as _, stream};
use gleaner_client::{UploadLabel, Uploaded};
use gleaner_proto::v1::*;
use tokio::{sync::watch, task::JoinSet};
use tokio_util::sync::CancellationToken;
use tonic::{Code, Status};

use super::{
    curator,
    lab::{Lab, changed, next_life, recording, retry, was_gone},
    sessions,
};
use crate::support::{
    api::Api,
    lab::{self as common, Recording},
};

/// Clients that push at the same time.
const PUSHING: usize = 8;

/// The running load.
pub struct Load {
    pushing: JoinSet<()>,
    others: JoinSet<()>,
    stop: CancellationToken,
}

/// Starts everything.
pub fn start(lab: &Arc<Lab>) -> Load {
    let (mut pushing, mut others, stop) = (JoinSet::new(), JoinSet::new(), CancellationToken::new());
    let next = Arc::new(AtomicU64::new(0));
    for _ in 0..PUSHING {
        pushing.spawn(push_all(Arc::clone(lab), Arc::clone(&next)));
    }
    others.spawn(jobs(Arc::clone(lab), stop.clone()));
    others.spawn(sessions::record(Arc::clone(lab), stop.clone()));
    others.spawn(curator::curate(Arc::clone(lab), stop.clone()));
    Load { pushing, others, stop }
}

impl Load {
    /// Fails the test if a client has failed.
    pub fn expect_running(&mut self) {
        for clients in [&mut self.pushing, &mut self.others] {
            while let Some(ended) = clients.try_join_next() {
                ended.unwrap();
            }
        }
    }

    /// Waits until everything is pushed, then cancels the other clients and waits for their end.
    pub async fn end(self) {
        let Self { pushing, others, stop } = self;
        pushing.join_all().await;
        stop.cancel();
        others.join_all().await;
    }
}

async fn push_all(lab: Arc<Lab>, next: Arc<AtomicU64>) {
    loop {
        let n = next.fetch_add(1, Ordering::Relaxed);
        if n >= lab.settings.uploads {
            return;
        }
        lab.due.subscribe().wait_for(|due| *due > n).await.unwrap();
        match n % 20 {
            3 => push_garbage(&lab, n).await,
            9 => push_slowly(&lab, n).await,
            14 => push_twice(&lab, n).await,
            _ => push(&lab, &recording(lab.settings.seed, n).await).await,
        }
    }
}

async fn push(lab: &Lab, recording: &Recording) {
    let uploaded = send(lab, recording).await;
    lab.ledger.add_episode(&uploaded.episode);
}

/// Pushes as `gleaner push` does, and again after it has failed.
async fn send(lab: &Lab, recording: &Recording) -> Uploaded {
    lab.ledger.add_attempt(&blake3::hash(&recording.bytes).to_hex());
    let path = lab.recordings.path().join(&recording.name);
    tokio::fs::write(&path, &recording.bytes).await.unwrap();
    let label =
        UploadLabel { outcome: recording.outcome, cohort: recording.cohort.clone(), author: "crash test".to_owned() };
    loop {
        match lab.client.upload(common::TASK, &path, &label, |_| {}).await {
            Ok(uploaded) => return uploaded,
            // Not found: the last response was lost, and no retry was left.
            Err(error) if error.is_transient() || error.code() == Some(Code::NotFound) => next_life(lab).await,
            Err(error) => panic!("{}: {error}", recording.name),
        }
    }
}

/// Two clients push the same content at the same time.
async fn push_twice(lab: &Lab, n: u64) {
    let one = recording(lab.settings.seed, n).await;
    let other = Recording { name: format!("again-{}", one.name), ..one.clone() };
    let (one, other) = tokio::join!(send(lab, &one), send(lab, &other));
    assert_eq!(one.episode.id, other.episode.id, "one content is one episode");
    // Added now, because another label would be rejected for the slower client.
    lab.ledger.add_episode(&one.episode);
}

/// A file that is not a recording is rejected and never listed.
async fn push_garbage(lab: &Lab, n: u64) {
    let bytes: Bytes = format!("not a recording {n} {}", lab.settings.seed).repeat(100).into();
    lab.ledger.add_garbage(blake3::hash(&bytes).to_hex().to_string());
    let path = lab.recordings.path().join(format!("garbage-{n}.mcap"));
    tokio::fs::write(&path, &bytes).await.unwrap();
    let label = UploadLabel { outcome: Outcome::Success, cohort: "garbage".into(), author: String::new() };
    loop {
        match lab.client.upload(common::TASK, &path, &label, |_| {}).await {
            Err(error) if error.is_transient() || error.code() == Some(Code::NotFound) => next_life(lab).await,
            Err(error) if error.code() == Some(Code::InvalidArgument) => return,
            other => panic!("{} was accepted as a recording: {other:?}", path.display()),
        }
    }
}

/// Holds its stream open until a half is committed, and never sends committed bytes again.
async fn push_slowly(lab: &Lab, n: u64) {
    let recording = recording(lab.settings.seed, n).await;
    lab.ledger.add_attempt(&blake3::hash(&recording.bytes).to_hex());
    let mut committed = 0;
    loop {
        match send_in_halves(lab, &recording, &mut committed).await {
            Ok(episode) => return lab.ledger.add_episode(&episode),
            Err(status) if was_gone(&status) || status.code() == Code::NotFound => next_life(lab).await,
            Err(status) => panic!("{}: {status}", recording.name),
        }
    }
}

async fn send_in_halves(lab: &Lab, recording: &Recording, committed: &mut u64) -> Result<Episode, Status> {
    let (mut api, whole) = (lab.api.clone(), recording.bytes.len() as u64);
    let started = common::start(&mut api, common::TASK, recording).await?;
    if let Some(episode) = started.existing {
        return Ok(episode);
    }
    let id = started.upload_id;
    assert!(started.committed_size >= *committed, "{} fell below {committed}", started.committed_size);
    *committed = started.committed_size;
    let half = whole / 2;
    if *committed < half {
        let (api_of_stream, id_of_stream) = (lab.api.clone(), id.clone());
        let message = |from: u64, to: u64| WriteUploadRequest {
            upload_id: id.clone(),
            offset: from,
            data: recording.bytes.slice(usize::try_from(from).unwrap()..usize::try_from(to).unwrap()),
        };
        let rest = message(half, whole);
        let lives = lab.lives.subscribe();
        let later = stream::once(async move {
            // An error means that the stream will end with one too.
            let _ = until_committed(api_of_stream, lives, id_of_stream, half).await;
            rest
        });
        let messages = stream::iter([message(*committed, half)]).chain(later);
        *committed = api.episodes.write_upload(messages).await?.into_inner().committed_size;
    } else if *committed < whole {
        let rest = recording.bytes.slice(usize::try_from(*committed).unwrap()..);
        *committed = common::write(&mut api, &id, *committed, rest).await?;
    }
    assert_eq!(*committed, whole);
    common::finish(&mut api, &id).await
}

async fn until_committed(mut api: Api, mut lives: watch::Receiver<u64>, id: String, bytes: u64) -> Result<(), Status> {
    loop {
        if api.committed_size(&id).await? >= bytes {
            return Ok(());
        }
        changed(&mut lives).await;
    }
}

/// Submits jobs, cancels some, and waits for the end of each.
async fn jobs(lab: Arc<Lab>, stop: CancellationToken) {
    let mut n = 0_u32;
    while !stop.is_cancelled() {
        n += 1;
        let spec = match n % 4 {
            0 => lab.score(),
            1 | 3 => lab.pretrain(4 + n % 4),
            _ => common::train(train_spec::Data::ExpertsOf(lab.encoder.clone()), 2 + n % 5),
        };
        let request = SubmitJobRequest {
            task: common::TASK.into(),
            spec: Some(JobSpec { spec: Some(spec) }),
            key: format!("crash {n}"),
            ..SubmitJobRequest::default()
        };
        let submitted = retry!(lab, jobs.submit_job(request)).unwrap();
        let job = submitted.into_inner().job.unwrap();
        lab.ledger.add_job(&job);
        let cancelled = n.is_multiple_of(3);
        if cancelled {
            cancel(&lab, &job.id).await;
        }
        let ended = watch(&lab, &job.id).await;
        match ended.state() {
            JobState::Succeeded if ended.kind() == JobKind::Train => lab.ledger.add_policy(ended.result_id.clone()),
            JobState::Succeeded => {}
            JobState::Cancelled if cancelled => {}
            state => panic!("{} ended as {state:?}: {}", ended.id, ended.error),
        }
        lab.ledger.add_job(&ended);
    }
}

async fn cancel(lab: &Lab, id: &str) {
    next_life(lab).await;
    let request = CancelJobRequest { job_id: id.to_owned() };
    match retry!(lab, jobs.cancel_job(request)) {
        Ok(_) => {}
        // The job has ended, or the response of an earlier call was lost.
        Err(status) => assert_eq!(status.code(), Code::FailedPrecondition, "{status}"),
    }
}

async fn watch(lab: &Lab, id: &str) -> Job {
    loop {
        match lab.client.watch(id, |_| {}).await {
            Ok(job) => return job,
            Err(error) if error.is_transient() || error.code().is_none() => next_life(lab).await,
            Err(error) => panic!("{id}: {error}"),
        }
    }
}
