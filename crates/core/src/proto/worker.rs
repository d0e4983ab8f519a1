//! The calls of a worker, both ways: the server sends and the worker reads assignments; the worker sends and the server
//! reads reports.

mod completion;
mod kept;

use std::net::SocketAddr;

use gleaner_proto::v1;

pub use self::completion::{Completion, completion_messages};
use super::{episode, field, job, order, score, task};
use crate::{
    episode::Outcome,
    error::{Error, Result},
    id::{BlobId, EpisodeId, JobId},
    job::Job,
    order::JobOrder,
    score::EpisodeScores,
    work::{FrozenRun, InputEpisode, InputPart, Inputs, Progress},
};

/// Longest stored error of a worker, in characters.
const LONGEST_ERROR: usize = 2000;

/// The assignment of a worker, without episodes.
pub fn assignment(assigned: Job, inputs: Inputs) -> v1::GetAssignmentResponse {
    // The episodes have messages of their own.
    let Inputs {
        experts: _,
        imperfect: _,
        kept: _,
        task: spec,
        encoder,
        checkpoint,
        segment_length,
        origin,
        policy,
        base,
    } = inputs;
    v1::GetAssignmentResponse {
        job: Some(job::job(assigned)),
        task: Some(task::spec_to_proto(spec)),
        encoder: encoder.map(String::from).unwrap_or_default(),
        checkpoint: checkpoint.map(String::from).unwrap_or_default(),
        segment_length,
        origin: origin.into_iter().collect(),
        policy: policy.map(String::from).unwrap_or_default(),
        base: base.map(|FrozenRun { lo, hi, quantiles, expert_ids }| v1::ScoreBase {
            lo,
            hi,
            quantiles,
            expert_ids: expert_ids.into_iter().map(Into::into).collect(),
        }),
    }
}

/// Some episodes of an assignment.
pub fn episodes(part: InputPart) -> v1::StreamEpisodesResponse {
    let all = |episodes: Vec<InputEpisode>| episodes.into_iter().map(episode_to).collect();
    let none = v1::StreamEpisodesResponse::default();
    match part {
        InputPart::Experts(episodes) => v1::StreamEpisodesResponse { experts: all(episodes), ..none },
        InputPart::Imperfect(episodes) => v1::StreamEpisodesResponse { imperfect: all(episodes), ..none },
        InputPart::Kept(kept) => {
            let (kept, match_episode_ids) = kept::to(kept);
            v1::StreamEpisodesResponse { kept, match_episode_ids, ..none }
        }
    }
}

/// Reads some episodes of an assignment.
///
/// # Errors
/// Invalid when the server speaks another version.
pub fn episodes_from(response: v1::StreamEpisodesResponse) -> Result<[InputPart; 3]> {
    let v1::StreamEpisodesResponse { experts, imperfect, kept, match_episode_ids } = response;
    let all = |episodes: Vec<v1::AssignedEpisode>| episodes.into_iter().map(episode_from).collect::<Result<_>>();
    Ok([
        InputPart::Experts(all(experts)?),
        InputPart::Imperfect(all(imperfect)?),
        InputPart::Kept(kept::from(kept, match_episode_ids)?),
    ])
}

/// One episode's scores of the run that a job extends.
pub fn base_scores(scores: EpisodeScores) -> v1::StreamBaseScoresResponse {
    let scores = EpisodeScores { q: Vec::new(), ..scores };
    v1::StreamBaseScoresResponse { scores: Some(score::episode_scores(scores, Vec::new())) }
}

/// Reads one episode's scores of that run, without q.
///
/// # Errors
/// Invalid when the server speaks another version.
pub fn base_scores_from(response: v1::StreamBaseScoresResponse) -> Result<EpisodeScores> {
    completion::scores_from(field::required("scores", response.scores)?)
}

fn episode_to(episode: InputEpisode) -> v1::AssignedEpisode {
    let InputEpisode { id, recording, steps, file_name, outcome, cohort } = episode;
    let (episode_id, recording, outcome) = (id.into(), recording.into(), episode::outcome_to_proto(outcome).into());
    v1::AssignedEpisode { episode_id, recording, steps, file_name, outcome, cohort }
}

/// Reads an assignment: the job, its order and its inputs without episodes.
///
/// # Errors
/// Invalid when the server speaks another version.
pub fn assigned(response: v1::GetAssignmentResponse) -> Result<(JobId, JobOrder, Inputs)> {
    let v1::GetAssignmentResponse { job, task: spec, encoder, checkpoint, segment_length, origin, policy, base } =
        response;
    let job = field::required("job", job)?;
    let inputs = Inputs {
        task: task::spec_from_proto(field::required("task", spec)?)?,
        experts: Vec::new(),
        imperfect: Vec::new(),
        kept: Vec::new(),
        encoder: blob_from("encoder", encoder)?,
        checkpoint: blob_from("checkpoint", checkpoint)?,
        segment_length,
        origin: origin.into_iter().collect(),
        policy: blob_from("policy", policy)?,
        base: base.map(base_from).transpose()?,
    };
    Ok((JobId::parse("job.id", &job.id)?, order::order(job.spec)?, inputs))
}

fn episode_from(episode: v1::AssignedEpisode) -> Result<InputEpisode> {
    let v1::AssignedEpisode { episode_id, recording, steps, file_name, outcome, cohort } = episode;
    Ok(InputEpisode {
        id: EpisodeId::parse("episode_id", &episode_id)?,
        recording: BlobId::parse("recording", &recording)?,
        steps,
        file_name,
        outcome: episode::outcome_from_proto("outcome", outcome)?.unwrap_or(Outcome::Unknown),
        cohort,
    })
}

fn base_from(base: v1::ScoreBase) -> Result<FrozenRun> {
    let v1::ScoreBase { lo, hi, quantiles, expert_ids } = base;
    let expert = |id: &String| EpisodeId::parse("base.expert_ids", id);
    Ok(FrozenRun { lo, hi, quantiles, expert_ids: expert_ids.iter().map(expert).collect::<Result<_>>()? })
}

fn blob_from(at: &str, blob: String) -> Result<Option<BlobId>> {
    if blob.is_empty() { Ok(None) } else { BlobId::parse(at, &blob).map(Some) }
}

/// Reads progress.
///
/// # Errors
/// Invalid names the field.
pub fn progress_request(request: v1::ReportProgressRequest) -> Result<Progress> {
    let v1::ReportProgressRequest { done, total, message, metrics, peak_memory_bytes } = request;
    let metrics = metrics.into_iter().enumerate().map(|(i, v1::Metric { step, name, value })| {
        if !value.is_finite() {
            return Err(Error::invalid(&format!("metrics[{i}].value"), "must be finite"));
        }
        Ok((step, field::text(&format!("metrics[{i}].name"), name)?, value))
    });
    Ok(Progress {
        done,
        total,
        message: field::tag("message", message)?,
        metrics: metrics.collect::<Result<_>>()?,
        peak_memory_bytes,
    })
}

/// Progress.
pub fn progress(progress: Progress) -> v1::ReportProgressRequest {
    let Progress { done, total, message, metrics, peak_memory_bytes } = progress;
    let metrics = metrics.into_iter().map(|(step, name, value)| v1::Metric { step, name, value }).collect();
    v1::ReportProgressRequest { done, total, message, metrics, peak_memory_bytes }
}

/// The address at which rank 0 waits for the other ranks.
///
/// # Errors
/// Invalid when it is not an IP address with a port.
pub fn meeting_request(request: v1::ReportMeetingRequest) -> Result<SocketAddr> {
    let v1::ReportMeetingRequest { address } = request;
    address.parse().map_err(|_| Error::invalid("address", "must be an IP address with a port, such as 10.0.0.5:41234"))
}

/// Reads that address; `None` while it is not reported.
///
/// # Errors
/// Invalid when the server speaks another version.
pub fn meeting(response: v1::GetMeetingResponse) -> Result<Option<SocketAddr>> {
    let v1::GetMeetingResponse { address } = response;
    if address.is_empty() {
        return Ok(None);
    }
    meeting_request(v1::ReportMeetingRequest { address }).map(Some)
}

/// The step and the blob to resume from.
///
/// # Errors
/// Invalid when the blob is no digest.
pub fn checkpoint_request(request: v1::SaveCheckpointRequest) -> Result<(u64, BlobId)> {
    let v1::SaveCheckpointRequest { step, blob } = request;
    Ok((step, BlobId::parse("blob", &blob)?))
}

/// A blob to read, and how.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlobQuery {
    /// The blob.
    pub blob: BlobId,
    /// Whether a URL is returned if the server signs one.
    pub accept_url: bool,
    /// Whether a copy is fetched if no URL is returned.
    pub fetch: bool,
}

/// Reads which blob is to be located.
///
/// # Errors
/// Invalid when the blob is no digest.
pub fn locate_request(request: v1::LocateBlobRequest) -> Result<BlobQuery> {
    let v1::LocateBlobRequest { blob, accept_url, fetch } = request;
    Ok(BlobQuery { blob: BlobId::parse("blob", &blob)?, accept_url, fetch })
}

/// Reads which blob is to be stored.
///
/// # Errors
/// Invalid when the blob is no digest.
pub fn store_request(request: v1::StoreBlobRequest) -> Result<BlobId> {
    let v1::StoreBlobRequest { blob } = request;
    BlobId::parse("blob", &blob)
}

/// The worker's error, shortened if it is long, and whether another attempt could help.
pub fn fail_request(request: v1::FailJobRequest) -> (String, bool) {
    let v1::FailJobRequest { error, retry } = request;
    let error = if error.is_empty() { "the worker gave no reason".to_owned() } else { error };
    (error.chars().take(LONGEST_ERROR).collect(), retry)
}

#[cfg(test)]
mod tests;
