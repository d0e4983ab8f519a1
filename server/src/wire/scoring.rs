//! Scores of recordings and steps that are not stored, on the wire.

use bytes::Bytes;
use gleaner_core::proto::recording::summary_from_proto;
use gleaner_proto::v1::{self, score_recording_request, score_steps_request, score_steps_response};

use super::{episode, field, policy};
use crate::{
    domain::{
        id::{EpisodeId, ScoreRunId},
        observation::Observation,
        score::SegmentScored,
        snapshot::Role,
        time::seconds,
    },
    error::{Error, Result},
    ingest::Declared,
    scorers::Output,
};

const OPEN_TWICE: &str = "the stream is open already; send one for each episode";

/// The first message of a recording; `None` if the stream ended before it.
pub(crate) fn recording_open(first: Option<v1::ScoreRecordingRequest>) -> Result<(ScoreRunId, Declared)> {
    match first.and_then(|first| first.message) {
        Some(score_recording_request::Message::Open(open)) => {
            let v1::ScoreRecordingOpen { score_run_id, file_name, size_bytes, summary } = open;
            let run = ScoreRunId::parse("open.score_run_id", &score_run_id)?;
            let file_name = field::tag("open.file_name", file_name)?;
            let size_bytes = (size_bytes > 0).then_some(size_bytes);
            Ok((run, Declared { file_name, size_bytes, summary: summary.map(summary_from_proto) }))
        }
        Some(score_recording_request::Message::Data(_)) | None => Err(open_first()),
    }
}

/// The next bytes of a recording.
pub(crate) fn recording_data(request: v1::ScoreRecordingRequest) -> Result<Bytes> {
    match field::required("message", request.message)? {
        // A stream of empty messages would never end and never be idle.
        score_recording_request::Message::Data(data) if data.is_empty() => {
            Err(Error::invalid("data", "is empty; send bytes of the recording, or end the stream"))
        }
        score_recording_request::Message::Data(data) => Ok(data),
        score_recording_request::Message::Open(_) => Err(Error::invalid("open", OPEN_TWICE)),
    }
}

/// The first message of an episode's steps; `None` if the stream ended before it.
pub(crate) fn steps_open(first: Option<v1::ScoreStepsRequest>) -> Result<ScoreRunId> {
    match first.and_then(|first| first.message) {
        Some(score_steps_request::Message::Open(v1::ScoreStepsOpen { score_run_id })) => {
            ScoreRunId::parse("open.score_run_id", &score_run_id)
        }
        Some(score_steps_request::Message::Step(_)) | None => Err(open_first()),
    }
}

/// The next step: its observation and its action.
pub(crate) fn step(request: v1::ScoreStepsRequest) -> Result<(Observation, Vec<f32>)> {
    let v1::ScoreStep { observation, action } = match field::required("message", request.message)? {
        score_steps_request::Message::Step(step) => step,
        score_steps_request::Message::Open(_) => return Err(Error::invalid("open", OPEN_TWICE)),
    };
    let path = "step.observation";
    let sent = policy::observation(path, field::required(path, observation)?)?;
    if !sent.executed_action.is_empty() {
        let fix = "applies to sessions; omit it, and send this step's action in step.action";
        return Err(Error::invalid("step.observation.executed_action", fix));
    }
    if sent.deadline.is_some() {
        let fix = "applies to sessions; omit it: every step is scored";
        return Err(Error::invalid("step.observation.deadline_us", fix));
    }
    if sent.skipped_steps > 0 {
        let fix = "applies to sessions; omit it, and send every step";
        return Err(Error::invalid("step.observation.skipped_steps", fix));
    }
    Ok((sent, action))
}

pub(crate) fn recording_response(
    scores: gleaner_learn::EpisodeScores,
    experts: &[EpisodeId],
    report: gleaner_recording::Report,
) -> v1::ScoreRecordingResponse {
    let gleaner_learn::EpisodeScores { episode_id, role, w, q, match_episode, match_step, distances } = scores;
    let distance = |modality: usize| distances.iter().map(|all| all[modality]).collect();
    // Only an expert of the run is stored, and has an id.
    let (episode_id, role) = match role {
        Role::Expert => (episode_id, v1::Role::Expert),
        Role::Imperfect => (String::new(), v1::Role::Unspecified),
    };
    let scores = v1::EpisodeScores {
        episode_id,
        role: role.into(),
        w,
        q,
        match_episode,
        match_step,
        distance_o: distance(0),
        distance_m: distance(1),
        distance_a: distance(2),
        expert_ids: experts.iter().map(ToString::to_string).collect(),
    };
    let duration_s = seconds(report.duration_ns);
    v1::ScoreRecordingResponse { scores: Some(scores), report: Some(episode::report(report, duration_s)) }
}

pub(crate) fn steps_response(output: Output) -> v1::ScoreStepsResponse {
    let message = match output {
        Output::Scored(segment) => score_steps_response::Message::Score(live_score(segment)),
        Output::Draining { close_at } => {
            let close_time = Some(field::timestamp(close_at));
            score_steps_response::Message::Draining(v1::SessionDraining { close_time })
        }
    };
    v1::ScoreStepsResponse { message: Some(message) }
}

/// The score of a segment of a running episode.
pub(crate) fn live_score(segment: SegmentScored) -> v1::LiveScore {
    let SegmentScored { stamp_ns, w, q, match_episode, match_step } = segment;
    let (q, match_episode_id) = (q.into(), match_episode.into());
    v1::LiveScore { w, q, match_episode_id, match_step, observation_stamp_ns: stamp_ns }
}

fn open_first() -> Error {
    Error::invalid("open", "must be the first message: it names the score run")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_piece_of_a_recording_is_rejected() {
        let data = |bytes: &'static [u8]| {
            let message = Some(score_recording_request::Message::Data(bytes.into()));
            recording_data(v1::ScoreRecordingRequest { message })
        };
        assert_eq!(data(b"x").unwrap(), "x");
        assert!(data(b"").unwrap_err().message().starts_with("data: "));
    }

    #[test]
    fn an_opening_is_checked() {
        let open = |score_run_id: String, file_name: &str| {
            let open =
                v1::ScoreRecordingOpen { score_run_id, file_name: file_name.to_owned(), size_bytes: 7, summary: None };
            recording_open(Some(v1::ScoreRecordingRequest {
                message: Some(score_recording_request::Message::Open(open)),
            }))
        };
        let run = || String::from(ScoreRunId::new());
        assert!(open(run(), "a.mcap").is_ok() && open(run(), "").is_ok());
        for (opened, field) in [
            (open("../x".into(), ""), "open.score_run_id: "),
            (open(run(), &"x".repeat(256)), "open.file_name: "),
            (open(run(), "a\nb"), "open.file_name: "),
        ] {
            let error = opened.err().unwrap();
            assert!(error.message().starts_with(field), "{field} expected: {error}");
        }
    }
}
