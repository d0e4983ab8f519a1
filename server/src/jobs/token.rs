//! Tokens: the proof that a call comes from the worker of one running attempt.
//!
//! A token is the job's id, a dot, and 256 random bits. Only the hash of the random part is stored.

use crate::{
    config::Secret,
    domain::{attempt::Attempt, id::JobId},
};

/// The random part of a token that does not belong to a job yet.
pub(super) struct Issuer {
    random: String,
    /// The stored hash.
    pub(super) hash: String,
}

impl Issuer {
    /// New random bits.
    pub(super) fn new() -> Self {
        let bits: [u8; 32] = rand::random();
        let random = blake3::Hash::from_bytes(bits).to_hex().to_string();
        let hash = hash(&random);
        Self { random, hash }
    }

    /// The attempt with this token that has claimed `job`.
    pub(super) fn attempt(&self, job: &JobId) -> Attempt {
        Attempt { job_id: job.clone(), token_hash: self.hash.clone() }
    }

    /// The complete token for `job`.
    pub(super) fn token(&self, job: &JobId) -> Secret {
        Secret::from(format!("{job}.{}", self.random))
    }
}

/// The attempt that a token names; `None` for a malformed token.
pub(super) fn attempt(token: &str) -> Option<Attempt> {
    let (job, random) = token.split_once('.')?;
    Some(Attempt { job_id: JobId::try_from(job.to_owned()).ok()?, token_hash: hash(random) })
}

fn hash(random: &str) -> String {
    blake3::hash(random.as_bytes()).to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_identifies_its_attempt_and_is_unique() {
        let (job, issuer) = (JobId::new(), Issuer::new());
        let token = issuer.token(&job);
        assert_eq!(attempt(token.reveal()).unwrap(), issuer.attempt(&job));
        assert!(!token.reveal().contains(&issuer.hash), "the stored hash is not a token");
        assert_ne!(Issuer::new().hash, issuer.hash);
        for other in ["", "token", "job_01ARZ3NDEKTSV4RRFFQ69G5FAV", "ep_01ARZ3NDEKTSV4RRFFQ69G5FAV.00"] {
            assert_eq!(attempt(other), None);
        }
    }
}
