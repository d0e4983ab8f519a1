//! A worker's calls, both ways: the server answers through `to`-conversions, the worker reads them and reports.

mod completion;

use gleaner_proto::v1;

pub(crate) use self::completion::{Completion, completion_messages};
use super::{field, job, order, task};
use crate::{
    domain::{
        dataset::KeptSegment,
        id::{BlobId, EpisodeId, JobId},
        job::Job,
        order::JobOrder,
        work::{InputEpisode, Inputs, KeptInput, Progress},
    },
    error::{Error, Result},
};

/// Longest error of a worker that is kept, in characters.
const LONGEST_ERROR: usize = 2000;

/// What a worker is given.
pub(crate) fn assignment(assigned: Job, inputs: Inputs) -> v1::GetAssignmentResponse {
    let Inputs { task: spec, experts, imperfect, kept, encoder, checkpoint, segment_length } = inputs;
    v1::GetAssignmentResponse {
        job: Some(job::job(assigned)),
        task: Some(task::spec_to(spec)),
        experts: experts.into_iter().map(episode_to).collect(),
        imperfect: imperfect.into_iter().map(episode_to).collect(),
        kept: kept.into_iter().map(kept_to).collect(),
        encoder: encoder.map(String::from).unwrap_or_default(),
        checkpoint: checkpoint.map(String::from).unwrap_or_default(),
        segment_length,
    }
}

fn episode_to(episode: InputEpisode) -> v1::AssignedEpisode {
    let InputEpisode { id, recording, steps, file_name } = episode;
    v1::AssignedEpisode { episode_id: id.into(), recording: recording.into(), steps, file_name }
}

fn kept_to(kept: KeptInput) -> v1::KeptSegments {
    let KeptInput { episode, segments, similarities, qualities } = kept;
    v1::KeptSegments {
        episode: Some(episode_to(episode)),
        end_steps: segments.iter().map(|segment| segment.end_step).collect(),
        weights: segments.iter().map(|segment| segment.weight).collect(),
        match_steps: segments.iter().map(|segment| segment.match_step).collect(),
        match_episode_ids: segments.into_iter().map(|segment| segment.match_episode.into()).collect(),
        similarities,
        qualities,
    }
}

/// What the worker reads: which job, what to do, and with what.
///
/// # Errors
/// Invalid when the server speaks another version.
pub(crate) fn assigned(response: v1::GetAssignmentResponse) -> Result<(JobId, JobOrder, Inputs)> {
    let v1::GetAssignmentResponse { job, task: spec, experts, imperfect, kept, encoder, checkpoint, segment_length } =
        response;
    let job = field::required("job", job)?;
    let inputs = Inputs {
        task: task::create_request(v1::CreateTaskRequest { spec })?,
        experts: experts.into_iter().map(episode_from).collect::<Result<_>>()?,
        imperfect: imperfect.into_iter().map(episode_from).collect::<Result<_>>()?,
        kept: kept.into_iter().map(kept_from).collect::<Result<_>>()?,
        encoder: blob_from("encoder", encoder)?,
        checkpoint: blob_from("checkpoint", checkpoint)?,
        segment_length,
    };
    Ok((JobId::parse("job.id", &job.id)?, order::order(job.spec)?, inputs))
}

fn episode_from(episode: v1::AssignedEpisode) -> Result<InputEpisode> {
    let v1::AssignedEpisode { episode_id, recording, steps, file_name } = episode;
    Ok(InputEpisode {
        id: EpisodeId::parse("episode_id", &episode_id)?,
        recording: BlobId::parse("recording", &recording)?,
        steps,
        file_name,
    })
}

fn kept_from(kept: v1::KeptSegments) -> Result<KeptInput> {
    let v1::KeptSegments { episode, end_steps, weights, match_steps, match_episode_ids, similarities, qualities } =
        kept;
    let count = end_steps.len();
    let lengths = [weights.len(), match_steps.len(), match_episode_ids.len()];
    if lengths.iter().any(|&length| length != count) || similarities.len() != qualities.len() {
        return Err(Error::invalid("kept", "its lists must be of one length"));
    }
    let rows = end_steps.into_iter().zip(weights).zip(match_steps.into_iter().zip(match_episode_ids));
    let segments = rows.map(|((end_step, weight), (match_step, expert))| {
        let match_episode = EpisodeId::parse("kept.match_episode_ids", &expert)?;
        Ok(KeptSegment { end_step, weight, match_episode, match_step })
    });
    let segments = segments.collect::<Result<_>>()?;
    Ok(KeptInput {
        episode: episode_from(field::required("kept.episode", episode)?)?,
        segments,
        similarities,
        qualities,
    })
}

fn blob_from(at: &str, blob: String) -> Result<Option<BlobId>> {
    if blob.is_empty() { Ok(None) } else { BlobId::parse(at, &blob).map(Some) }
}

/// Reads progress.
///
/// # Errors
/// Invalid names the field.
pub(crate) fn progress_request(request: v1::ReportProgressRequest) -> Result<Progress> {
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
pub(crate) fn progress(progress: Progress) -> v1::ReportProgressRequest {
    let Progress { done, total, message, metrics, peak_memory_bytes } = progress;
    let metrics = metrics.into_iter().map(|(step, name, value)| v1::Metric { step, name, value }).collect();
    v1::ReportProgressRequest { done, total, message, metrics, peak_memory_bytes }
}

/// The step and the blob to resume from.
///
/// # Errors
/// Invalid when the blob is no digest.
pub(crate) fn checkpoint_request(request: v1::SaveCheckpointRequest) -> Result<(u64, BlobId)> {
    let v1::SaveCheckpointRequest { step, blob } = request;
    Ok((step, BlobId::parse("blob", &blob)?))
}

/// What went wrong, shortened if it is long, and whether another attempt could help.
pub(crate) fn fail_request(request: v1::FailJobRequest) -> (String, bool) {
    let v1::FailJobRequest { error, retry } = request;
    let error = if error.is_empty() { "the worker gave no reason".to_owned() } else { error };
    (error.chars().take(LONGEST_ERROR).collect(), retry)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use gleaner_recording::{FieldSource, Mapping};

    use super::*;
    use crate::domain::{
        id::{DatasetId, TaskId},
        job::{JobSpec, JobState},
        time::Millis,
    };

    fn blob(text: &str) -> BlobId {
        blake3::hash(text.as_bytes()).into()
    }

    fn input(text: &str) -> InputEpisode {
        InputEpisode { id: EpisodeId::new(), recording: blob(text), steps: 20, file_name: format!("{text}.mcap") }
    }

    fn export() -> Job {
        Job {
            id: JobId::new(),
            task_id: TaskId::new(),
            spec: JobSpec::Export { dataset_id: DatasetId::new() },
            state: JobState::Running,
            priority: 0,
            result_id: "exp".into(),
            done: 0,
            total: 0,
            message: String::new(),
            error: String::new(),
            attempt: 1,
            max_attempts: 3,
            cancel_requested: false,
            checkpoint: None,
            checkpoint_step: None,
            peak_memory_bytes: 0,
            needs: Vec::new(),
            created_at: Millis(0),
            started_at: None,
            ended_at: None,
        }
    }

    #[test]
    fn an_assignment_survives_the_wire() {
        let expert = input("expert");
        let segment = KeptSegment { end_step: 3, weight: 0.95, match_episode: expert.id.clone(), match_step: 4 };
        let mut task = crate::store::testing::spec();
        let source = |field: &str| FieldSource {
            field: field.into(),
            topic: "/state".into(),
            paths: vec!["position".into()],
            names: Vec::new(),
        };
        task.mappings = vec![Mapping {
            name: "plain".into(),
            cameras: Vec::new(),
            fields: vec![source("joint_position"), source("joint_velocity")],
            clock: None,
        }];
        let inputs = Inputs {
            task,
            experts: vec![expert],
            imperfect: vec![input("imperfect")],
            kept: vec![KeptInput {
                episode: input("kept"),
                segments: vec![segment],
                similarities: vec![-0.5],
                qualities: vec![0.95],
            }],
            encoder: Some(blob("encoder")),
            checkpoint: None,
            segment_length: 6,
        };
        let job = export();
        let (id, order, read) = assigned(assignment(job.clone(), inputs.clone())).unwrap();
        assert_eq!((id, read), (job.id, inputs));
        assert!(matches!(order, JobOrder::Export { .. }));
    }

    #[test]
    fn progress_survives_the_wire_unless_it_is_no_number() {
        let said = Progress {
            done: 3,
            total: 9,
            message: "training".into(),
            metrics: vec![(3, "loss".into(), 0.5)],
            peak_memory_bytes: 77,
        };
        assert_eq!(progress_request(progress(said.clone())).unwrap(), said);
        let broken = Progress { metrics: vec![(3, "loss".into(), f64::NAN)], ..said };
        let error = progress_request(progress(broken)).unwrap_err();
        assert!(error.message().starts_with("metrics[0].value: "), "{error}");
    }

    #[test]
    fn a_long_error_is_shortened() {
        let (error, retry) = fail_request(v1::FailJobRequest { error: "ü".repeat(9000), retry: true });
        assert_eq!((error.chars().count(), retry), (LONGEST_ERROR, true));
    }
}
