//! The caller on the workers' listener: the worker of one running attempt of a job, identified by the token of the attempt.

use tonic::codegen::http::HeaderMap;

use super::secret;
use crate::{
    domain::{attempt::Attempt, job::Job},
    error::{Error, Result},
    jobs::{Caller, Jobs},
};

/// The metadata with which a worker identifies its process: random characters, the same in each of its calls.
const PROCESS: &str = "worker-process";
/// The metadata with which a worker names its node of a cluster; empty elsewhere.
const NODE: &str = "worker-node";
/// The metadata with which a worker of an attempt with several processes gives its number; 0 without it.
const RANK: &str = "worker-rank";
const LONGEST_NAME: usize = 255;

/// A worker, as the guard has authenticated it.
#[derive(Debug, Clone)]
pub(crate) struct Worker {
    pub(crate) attempt: Attempt,
    pub(crate) job: Job,
    /// Its number among the processes of the attempt.
    rank: u32,
}

impl Worker {
    /// The worker that makes a request which changes something: rank 0 of its attempt.
    ///
    /// # Errors
    /// Forbidden for another rank; Internal when no guard precedes the service.
    pub(crate) fn of<T>(request: &tonic::Request<T>) -> Result<Self> {
        let worker = Self::any_rank(request)?;
        if worker.rank > 0 {
            return Err(Error::forbidden(format!("rank {} of this attempt cannot do this; rank 0 does", worker.rank)));
        }
        Ok(worker)
    }

    /// The worker of any rank that makes a request.
    ///
    /// # Errors
    /// Internal when no guard precedes the service.
    pub(crate) fn any_rank<T>(request: &tonic::Request<T>) -> Result<Self> {
        let worker = request.extensions().get::<Self>().cloned();
        worker.ok_or_else(|| Error::internal("identifying a worker", "no guard precedes this service"))
    }

    /// The worker whose token a request has.
    ///
    /// # Errors
    /// Unauthenticated.
    pub(super) async fn authenticate(jobs: &Jobs, headers: &HeaderMap) -> Result<Self> {
        let not_this_job = || {
            Error::unauthenticated(
                "this call needs the token of a running attempt of a job; this attempt is over, or another process runs it",
            )
        };
        let token = secret::bearer(headers)?.ok_or_else(not_this_job)?;
        let (process, nodes) = (name(headers, PROCESS)?, text(headers, NODE));
        // The nodes are for people only; a long list is cut.
        let node = nodes.get(..LONGEST_NAME).unwrap_or(nodes);
        let caller = Caller { process, node, rank: rank(headers)? };
        let (attempt, job) = jobs.authenticate(token, &caller).await?.ok_or_else(not_this_job)?;
        Ok(Self { attempt, job, rank: caller.rank })
    }
}

fn rank(headers: &HeaderMap) -> Result<u32> {
    match name(headers, RANK)? {
        "" => Ok(0),
        text => text.parse().map_err(|_| Error::invalid(RANK, "must be a number from 0")),
    }
}

fn name<'a>(headers: &'a HeaderMap, key: &'static str) -> Result<&'a str> {
    let name = text(headers, key);
    if name.len() > LONGEST_NAME {
        return Err(Error::invalid(key, format!("must be at most {LONGEST_NAME} characters")));
    }
    Ok(name)
}

/// A value of visible ASCII characters; empty for any other.
fn text<'a>(headers: &'a HeaderMap, key: &'static str) -> &'a str {
    headers.get(key).and_then(|text| text.to_str().ok()).unwrap_or_default()
}
