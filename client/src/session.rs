//! Session: a robot's running episode on a deployed policy; observations in, actions out.

use bytes::Bytes;
use futures::StreamExt as _;
use futures::stream::BoxStream;
use gleaner_proto::v1::session_request::Message as Request;
use gleaner_proto::v1::session_response::Message as Response;
use gleaner_proto::v1::{
    CameraFrame, Image, ImageFormat, Observation, Outcome, SessionAction, SessionClose, SessionClosed, SessionOpen,
    SessionOpened, SessionRequest, SessionResponse,
};
use gleaner_recording::{TaskSpec, frame_bytes_per_step};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;

use crate::connection::Client;
use crate::error::{ClientError, Result};

/// One running episode in lock step: each observation waits for its action. The server keeps its history; drop it to
/// abandon the episode. For a robot in real time, use [`Client::control`].
#[derive(Debug)]
pub struct Session {
    requests: mpsc::Sender<Request>,
    responses: Streaming<SessionResponse>,
    opened: SessionOpened,
    draining: bool,
}

impl Session {
    /// Opens a session on a deployment, for example `pick_cube@prod`, at the task's own control rate and without a
    /// deadline.
    ///
    /// # Errors
    /// [`ClientError::Rejected`]: no such deployment, or its policy can't be loaded.
    pub async fn open(client: &Client, deployment: &str) -> Result<Self> {
        Self::open_with(client, SessionOpen { deployment: deployment.to_owned(), ..SessionOpen::default() }).await
    }

    /// Opens a session with all settings of the message: rate, deadline, recording, cohort.
    ///
    /// # Errors
    /// As [`Session::open`]; also for an invalid control rate.
    pub async fn open_with(client: &Client, open: SessionOpen) -> Result<Self> {
        let (requests, outgoing) = mpsc::channel(1);
        // Before the call: the server may wait for it before it answers.
        send(&requests, Request::Open(open)).await;
        let outgoing = ReceiverStream::new(outgoing).map(|message| SessionRequest { message: Some(message) });
        let mut responses = client.policies().session(outgoing).await?.into_inner();
        match next(&mut responses).await? {
            Response::Opened(opened) => Ok(Self { requests, responses, opened, draining: false }),
            Response::Action(_) | Response::Missed(_) | Response::Draining(_) | Response::Closed(_) => {
                Err(ClientError::Contract { missing: "an opened session" })
            }
        }
    }

    /// The session's id, policy and task.
    #[must_use]
    pub fn opened(&self) -> &SessionOpened {
        &self.opened
    }

    /// Whether the server has announced that it is stopping; it still answers this session until it closes it.
    #[must_use]
    pub fn draining(&self) -> bool {
        self.draining
    }

    /// Sends an observation and waits for the actions that answer it: one per control period, from the observation's
    /// stamp on.
    ///
    /// # Errors
    /// [`ClientError::Missed`]: not by its deadline; the session continues. [`ClientError::Rejected`]: the observation
    /// does not fit the task (the message names the field), or the session failed.
    pub async fn act(&mut self, observation: Observation) -> Result<SessionAction> {
        send(&self.requests, Request::Observation(observation)).await;
        match self.answer().await? {
            Response::Action(action) => Ok(action),
            Response::Missed(missed) => Err(ClientError::Missed {
                waited_us: missed.timings.map_or(0, |timings| timings.total_us),
                stamp_ns: missed.observation_stamp_ns,
                reason: missed.reason,
            }),
            Response::Opened(_) | Response::Draining(_) | Response::Closed(_) => {
                Err(ClientError::Contract { missing: "an action" })
            }
        }
    }

    /// Ends the episode with an unknown outcome.
    ///
    /// # Errors
    /// As [`Session::close_as`].
    pub async fn close(self) -> Result<SessionClosed> {
        self.close_as(Outcome::Unknown).await
    }

    /// Ends the episode with this outcome. A recorded episode is stored when this returns, and its id returned, unless
    /// it has fewer than two steps.
    ///
    /// # Errors
    /// [`ClientError::Rejected`] when the session failed, or its recording can't be stored.
    pub async fn close_as(mut self, outcome: Outcome) -> Result<SessionClosed> {
        send(&self.requests, Request::Close(SessionClose { outcome: outcome.into() })).await;
        match self.answer().await? {
            Response::Closed(closed) => Ok(closed),
            Response::Opened(_) | Response::Action(_) | Response::Missed(_) | Response::Draining(_) => {
                Err(ClientError::Contract { missing: "the session's end" })
            }
        }
    }

    /// The next message, without the announcement of a stop, which sets `draining`.
    async fn answer(&mut self) -> Result<Response> {
        loop {
            match next(&mut self.responses).await? {
                Response::Draining(_) => self.draining = true,
                answer @ (Response::Opened(_) | Response::Action(_) | Response::Missed(_) | Response::Closed(_)) => {
                    return Ok(answer);
                }
            }
        }
    }

    /// The server's answer to the opening and both directions, for callers that do not run in lock step.
    pub(crate) fn into_parts(self) -> (SessionOpened, mpsc::Sender<Request>, BoxStream<'static, Result<Response>>) {
        let responses = self.responses.map(|response| message(response?));
        (self.opened, self.requests, responses.boxed())
    }
}

// Fails when the server has ended the stream; the reason arrives with the next response.
async fn send(requests: &mpsc::Sender<Request>, message: Request) {
    let _ = requests.send(message).await;
}

async fn next(responses: &mut Streaming<SessionResponse>) -> Result<Response> {
    let response = responses.message().await?;
    message(response.ok_or_else(|| ClientError::SessionLost("the stream ended".into()))?)
}

fn message(response: SessionResponse) -> Result<Response> {
    response.message.ok_or(ClientError::Contract { missing: "a session message" })
}

/// Builds an observation from one step's frames, in the layout of [`gleaner_recording::FrameBytes`], and its M
/// proprioception values. Images are sent raw.
///
/// # Errors
/// [`ClientError::Invalid`] when the frames do not have the task's sizes.
pub fn observation(spec: &TaskSpec, stamp_ns: i64, frames: Vec<u8>, proprioception: Vec<f32>) -> Result<Observation> {
    let expected = frame_bytes_per_step(spec);
    if frames.len() != expected {
        return Err(ClientError::Invalid(format!(
            "frames: expected {expected} bytes (one step of task {}), got {} bytes",
            spec.name,
            frames.len()
        )));
    }
    let mut rest = Bytes::from(frames);
    let mut raw = |size: usize| Image { format: ImageFormat::Raw.into(), data: rest.split_to(size) };
    let mut cameras = Vec::with_capacity(spec.cameras.len());
    for camera in &spec.cameras {
        let pixels = camera.height as usize * camera.width as usize;
        cameras.push(CameraFrame {
            camera: camera.name.clone(),
            color: Some(raw(pixels * 3)),
            depth: camera.depth.then(|| raw(pixels * 2)),
        });
    }
    Ok(Observation { stamp_ns, cameras, proprioception, ..Observation::default() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> TaskSpec {
        toml::from_str(
            r#"
            name = "t"
            rate_hz = 10.0
            cameras = [{ name = "table", height = 1, width = 2, depth = true }, { name = "hand", height = 2, width = 1 }]
            proprioception = [{ name = "q", size = 1 }]
            action = [{ name = "dq", size = 1 }]
            "#,
        )
        .unwrap()
    }

    #[test]
    fn frames_are_split_into_the_tasks_cameras() {
        let built = observation(&spec(), 7, (0..16).collect(), vec![0.5]).unwrap();
        let sizes: Vec<_> = built
            .cameras
            .iter()
            .map(|c| (c.camera.as_str(), c.color.as_ref().unwrap().data.len(), c.depth.as_ref().map(|d| d.data.len())))
            .collect();
        assert_eq!(sizes, [("table", 6, Some(4)), ("hand", 6, None)]);
        assert_eq!(built.cameras[0].depth.as_ref().unwrap().data[..], [6, 7, 8, 9]);
        assert_eq!(built.cameras[1].color.as_ref().unwrap().data[..], [10, 11, 12, 13, 14, 15]);
    }

    #[test]
    fn frames_of_the_wrong_size_are_rejected() {
        let error = observation(&spec(), 7, vec![0; 15], vec![0.5]).unwrap_err();
        assert!(error.to_string().contains("15 bytes") && error.to_string().contains("16"), "{error}");
    }
}
