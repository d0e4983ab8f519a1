//! Scores made elsewhere: collected episode by episode, checked against their snapshot, and stored as a score run.
//!
//! Must not depend on wire types or SQL.

use std::collections::HashMap;

use crate::{
    blobs::Blobs,
    domain::{
        id::{EncoderId, EpisodeId, ScoreRunId, SnapshotId, TaskId},
        score::{EpisodeScores, Origin, ScoreRun},
        snapshot::{Role, SnapshotEpisode},
        time::Millis,
    },
    error::{Error, Result},
    store::Store,
};

/// The field of a request that has episodes.
const EPISODES: &str = "batch.episodes";

/// The snapshot, source and encoder of an import.
#[derive(Debug, Clone)]
pub(crate) struct Opening {
    /// The snapshot that was scored.
    pub(crate) snapshot_id: SnapshotId,
    /// What made the scores, for people; may be empty.
    pub(crate) source: String,
    /// The encoder that policies trained on the run's datasets start from.
    pub(crate) encoder_id: Option<EncoderId>,
}

/// The scores of one episode.
#[derive(Debug, Clone)]
pub(crate) struct Imported {
    /// The episode.
    pub(crate) episode_id: EpisodeId,
    /// q of each step.
    pub(crate) q: Vec<f64>,
}

/// An import that is still arriving. It holds 12 bytes a step, at most for every step of its snapshot once.
#[derive(Debug)]
pub(crate) struct Import {
    opening: Opening,
    task_id: TaskId,
    members: Vec<SnapshotEpisode>,
    places: HashMap<EpisodeId, usize>,
    /// By place in the snapshot; `None` until the episode arrives.
    scores: Vec<Option<EpisodeScores>>,
}

impl Import {
    /// Begins an import.
    ///
    /// # Errors
    /// NotFound; Invalid for an encoder of another task; Precondition when the encoder is not finished or a recording of
    /// the snapshot was permanently deleted; Exhausted when the disk is nearly full.
    pub(crate) async fn begin(store: &Store, blobs: &Blobs, opening: Opening) -> Result<Self> {
        let (snapshot, members) = store.snapshot(&opening.snapshot_id).await?;
        store.expect_recordings(&snapshot.id).await?;
        if let Some(id) = &opening.encoder_id {
            let task = store.encoder(id).await?.task_id;
            if task != snapshot.task_id {
                let (of, wanted) = (task, &snapshot.task_id);
                let fix = format!("{id} belongs to {of}, the snapshot to {wanted}; name an encoder of that task");
                return Err(Error::invalid("open.encoder_id", fix));
            }
        }
        blobs.room_for(0).await?;
        let places = members.iter().map(|member| member.episode_id.clone()).zip(0..).collect();
        let scores = vec![None; members.len()];
        Ok(Self { opening, task_id: snapshot.task_id, members, places, scores })
    }

    /// Adds an episode.
    ///
    /// # Errors
    /// Invalid for an episode that is not in the snapshot, is duplicated or has another number of steps, and for a q
    /// outside 0 to 1; the message names the episode and the step.
    pub(crate) fn add(&mut self, Imported { episode_id, q }: Imported) -> Result<()> {
        let place = self.places.get(&episode_id).copied();
        let found = place.and_then(|place| Some((self.members.get(place)?, self.scores.get_mut(place)?)));
        let Some((member, scores)) = found else {
            let fix = format!("{episode_id} is not in {}; leave it out", self.opening.snapshot_id);
            return Err(Error::invalid(EPISODES, fix));
        };
        if scores.is_some() {
            return Err(Error::invalid(EPISODES, format!("{episode_id} is duplicated; send each episode once")));
        }
        if u64::try_from(q.len()) != Ok(member.steps) {
            let (steps, values) = (member.steps, q.len());
            let fix = format!("{episode_id} has {steps} steps, q has {values} values; send one for each step");
            return Err(Error::invalid(EPISODES, fix));
        }
        if let Some((step, q)) = q.iter().enumerate().find(|(_, q)| !(0.0..=1.0).contains(*q)) {
            let fix = format!("is {q} at step {step} of {episode_id}, must be between 0 and 1");
            return Err(Error::invalid("batch.episodes.q", fix));
        }
        *scores = Some(scored(episode_id, member.role, q));
        Ok(())
    }

    /// Stores the run, or returns the run that the same import stored before.
    ///
    /// # Errors
    /// Invalid names an episode that is missing.
    pub(crate) async fn finish(self, store: &Store) -> Result<ScoreRun> {
        self.expect_all()?;
        let digest = self.digest();
        let Self { opening: Opening { snapshot_id, source, encoder_id }, task_id, members, places: _, scores } = self;
        let experts = members.into_iter().filter(|member| member.role == Role::Expert);
        let run = ScoreRun {
            id: ScoreRunId::new(),
            task_id,
            origin: Origin::Import { encoder_id, source },
            snapshot_id,
            lo: 0.0,
            hi: 1.0,
            quantiles: Vec::new(),
            extends: None,
            expert_ids: experts.map(|member| member.episode_id).collect(),
            created_at: Millis::now(),
        };
        let scores: Vec<EpisodeScores> = scores.into_iter().flatten().collect();
        store.insert_import(&run, &digest, &scores).await
    }

    /// Every imperfect episode is there, and every expert or none.
    fn expect_all(&self) -> Result<()> {
        let expert_came = self.scores.iter().flatten().any(|scores| scores.role == Role::Expert);
        let missing = self.members.iter().zip(&self.scores).find(|(member, scores)| {
            scores.is_none()
                && match member.role {
                    Role::Imperfect => true,
                    Role::Expert => expert_came,
                }
        });
        let Some((SnapshotEpisode { episode_id, role, steps, .. }, _)) = missing else { return Ok(()) };
        let rule = match role {
            Role::Imperfect => "send every imperfect episode of the snapshot",
            Role::Expert => "send every expert of the snapshot, or none",
        };
        let role = role.as_str();
        Err(Error::invalid(EPISODES, format!("{episode_id} ({role}, {steps} steps) is missing; {rule}")))
    }

    /// Identifies the import by all that it contains, in the snapshot's order.
    fn digest(&self) -> String {
        let Opening { snapshot_id, source, encoder_id } = &self.opening;
        let mut hasher = blake3::Hasher::new();
        for text in [snapshot_id.as_str(), source, encoder_id.as_ref().map_or("", EncoderId::as_str)] {
            // No text has a zero byte.
            hasher.update(text.as_bytes()).update(&[0]);
        }
        for EpisodeScores { episode_id, w, .. } in self.scores.iter().flatten() {
            // The snapshot fixes the number of steps.
            hasher.update(episode_id.as_str().as_bytes());
            w.iter().for_each(|w| {
                hasher.update(&w.to_le_bytes());
            });
        }
        hasher.finalize().to_hex().to_string()
    }
}

/// Scores without matches. w is q in double precision, so that a top fraction keeps the order of values that are equal
/// once rounded.
#[expect(clippy::cast_possible_truncation, reason = "rounded on purpose: q is stored in single precision")]
fn scored(episode_id: EpisodeId, role: Role, w: Vec<f64>) -> EpisodeScores {
    let q = w.iter().map(|&w| w as f32).collect();
    EpisodeScores { episode_id, role, w, q, match_episode: Vec::new(), match_step: Vec::new(), distances: Vec::new() }
}

#[cfg(test)]
mod tests;
