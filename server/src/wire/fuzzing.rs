//! Doors for the fuzzer: every message that a caller or a worker sends, decoded and converted. Built with the feature
//! `fuzzing` only, which no released build enables.

use std::{fmt::Debug, sync::Arc};

use gleaner_learn::{CameraShape, TaskShape};
use gleaner_proto::{inference as oip, v1};
use gleaner_recording::Limits;
use prost::Message;

use super::{
    dataset, episode, evaluation, import, inference, job, policy, remote, schedule, score, scoring, selection, session,
    snapshot, task, upload, worker,
};
use crate::{
    domain::{client::Client, id::TaskId, time::Millis},
    error::{Kind, Result},
};

/// How many kinds of messages [`message`] knows.
pub const KINDS: u8 = 41;

/// Decodes `bytes` as a message of this kind and converts it. What is refused is refused as Invalid or Exhausted, and
/// names a field and a fix.
pub fn message(kind: u8, bytes: &[u8]) {
    match kind % KINDS {
        0 => convert(bytes, |request| task::create_request(request, &Limits::default())),
        34 => convert(bytes, |request| task::update_request(request, &Limits::default())),
        1 => convert(bytes, |request| upload::start_request(request, TaskId::new(), Client::Server)),
        2 => convert(bytes, upload::chunk),
        3 => convert(bytes, |request| episode::list_request(request, TaskId::new()).map(|_| ())),
        4 => convert(bytes, episode::label_request),
        5 => convert(bytes, job::submit_request),
        6 => convert(bytes, job::pipeline_request),
        7 => convert(bytes, |request| job::list_request(request).map(|_| ())),
        8 => convert(bytes, |request| schedule::create_request(request, Millis(0)).map(|_| ())),
        9 => convert(bytes, snapshot::create_request),
        10 => convert(bytes, dataset::create_request),
        11 => convert(bytes, |request| dataset::segments_request(request).map(|_| ())),
        12 => convert(bytes, dataset::download_request),
        13 => convert(bytes, policy::deploy_request),
        14 => convert(bytes, policy::roll_back_request),
        15 => convert(bytes, policy::act_request),
        16 => convert(bytes, session::session_input),
        17 => convert(bytes, evaluation::report_request),
        18 => convert(bytes, score::episode_scores_request),
        19 => convert(bytes, |request| score::histogram_request(request).map(|_| ())),
        20 => convert(bytes, selection::count_request),
        21 => convert(bytes, |request| scoring::recording_open(Some(request)).map(|_| ())),
        22 => convert(bytes, scoring::recording_data),
        23 => convert(bytes, |request| scoring::steps_open(Some(request))),
        24 => convert(bytes, scoring::step),
        25 => convert(bytes, |request| worker::progress_request(request).map(|_| ())),
        26 => convert(bytes, worker::checkpoint_request),
        27 => convert(bytes, |request| Ok(worker::fail_request(request))),
        28 => convert(bytes, |request| worker::Completion::default().push(request)),
        29 => convert(bytes, |response: v1::GetAssignmentResponse| worker::assigned(response).map(|_| ())),
        30 => convert(bytes, |request| import::open(Some(request))),
        31 => convert(bytes, import::batch),
        32 => convert(bytes, worker::episodes_from),
        33 => convert(bytes, worker::meeting_request),
        35 => convert(bytes, remote::register_request),
        36 => convert(bytes, schedule::list_request),
        37 => convert(bytes, worker::locate_request),
        38 => convert(bytes, worker::store_request),
        39 => convert(bytes, policy::delete_request),
        _ => convert(bytes, infer),
    }
}

/// Decodes an observation and its images, as a session's and a tensor request's are.
pub async fn observation(bytes: &[u8]) {
    let Ok(sent) = v1::Observation::decode(bytes) else { return };
    let Ok(observation) = policy::observation("observation", sent) else { return };
    let shape = shape();
    let wanted = shape.frame_bytes();
    match crate::policies::observation::frames(Arc::new(shape), "observation", observation).await {
        Ok(frames) => assert_eq!(frames.len(), wanted),
        Err(error) => assert_eq!(error.kind(), Kind::Invalid, "{error}"),
    }
}

fn infer(request: oip::ModelInferRequest) -> Result<()> {
    let inference::Request { deployment: _, version: _, id: _, place: _, inputs } = inference::request(request)?;
    inference::observation(&inference::Tensors::of(&shape())?, inputs).map(|_| ())
}

fn convert<M: Message + Default, T: Debug>(bytes: &[u8], from_proto: impl Fn(M) -> Result<T>) {
    let Ok(message) = M::decode(bytes) else { return };
    if let Err(error) = from_proto(message) {
        assert!(matches!(error.kind(), Kind::Invalid | Kind::Exhausted), "{error}");
        assert!(error.message().len() < 16 << 10, "a refusal of {} bytes fits no header", error.message().len());
    }
}

fn shape() -> TaskShape {
    let camera = |name: &str, depth| CameraShape { name: name.to_owned(), height: 8, width: 8, depth, recorded: None };
    TaskShape {
        cameras: vec![camera("top", true), camera("wrist", false)],
        proprioception: 2,
        action: 1,
        ranges: gleaner_core::action::ActionRanges::default(),
    }
}
