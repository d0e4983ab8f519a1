//! The upload's rules against an in-process service that fails on demand.

mod joined;

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::Mutex;

use futures::Stream;
use gleaner_proto::v1::episode_service_server::{EpisodeService, EpisodeServiceServer};
use gleaner_proto::v1::{
    DeleteEpisodesRequest, DeleteEpisodesResponse, DownloadEpisodeRequest, DownloadEpisodeResponse,
    FinishUploadResponse, GetEpisodeRequest, GetEpisodeResponse, GetUploadResponse, LabelEpisodesRequest,
    LabelEpisodesResponse, ListEpisodesRequest, ListEpisodesResponse, ListLabelsRequest, ListLabelsResponse,
    StartUploadResponse, UndeleteEpisodesRequest, UndeleteEpisodesResponse, WriteUploadResponse,
};
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Request, Response, Status, Streaming};

use super::pieces::PIECE;
use super::*;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    // The write fails after one message, which is kept.
    WriteBreaks,
    // The server loses the open upload.
    Forgets,
    // The episode is stored, but the answer is lost.
    FinishAnswerLost,
    // The server rejects the upload.
    Refuses,
}

#[derive(Default)]
struct Store {
    faults: VecDeque<Fault>,
    open: Option<(StartUploadRequest, Vec<u8>)>,
    stored: Option<(Episode, Vec<u8>)>,
    offsets: Vec<u64>,
}

#[derive(Clone, Default)]
struct Fake(Arc<Mutex<Store>>);

impl Fake {
    fn store(&self) -> std::sync::MutexGuard<'_, Store> {
        self.0.lock().unwrap()
    }

    fn meets(&self, fault: Fault) -> bool {
        let faults = &mut self.store().faults;
        faults.front() == Some(&fault) && faults.pop_front().is_some()
    }
}

type Reply<T> = std::result::Result<Response<T>, Status>;

#[tonic::async_trait]
impl EpisodeService for Fake {
    async fn start_upload(&self, request: Request<StartUploadRequest>) -> Reply<StartUploadResponse> {
        if self.meets(Fault::Refuses) {
            return Err(Status::already_exists("the content is there as failure; relabel it"));
        }
        let request = request.into_inner();
        let mut store = self.store();
        let existing = store.stored.as_ref().map(|(episode, _)| episode.clone());
        let upload_id = if existing.is_none() { "upl_1".into() } else { String::new() };
        if store.open.is_none() {
            store.open = Some((request, Vec::new()));
        }
        let committed_size = store.open.as_ref().unwrap().1.len() as u64;
        Ok(Response::new(StartUploadResponse { upload_id, committed_size, existing, estimate: None }))
    }

    async fn write_upload(&self, request: Request<Streaming<WriteUploadRequest>>) -> Reply<WriteUploadResponse> {
        let mut pieces = request.into_inner();
        while let Some(piece) = pieces.message().await? {
            let breaks = self.meets(Fault::WriteBreaks);
            let forgets = self.meets(Fault::Forgets);
            let mut store = self.store();
            if forgets {
                store.open = None;
            }
            store.offsets.push(piece.offset);
            let (_, bytes) = store.open.as_mut().ok_or_else(|| Status::not_found("no such upload"))?;
            if piece.offset != bytes.len() as u64 {
                return Err(Status::invalid_argument("offset"));
            }
            bytes.extend_from_slice(&piece.data);
            if breaks {
                return Err(Status::unavailable("going down"));
            }
        }
        let committed_size = self.store().open.as_ref().unwrap().1.len() as u64;
        Ok(Response::new(WriteUploadResponse { committed_size }))
    }

    async fn get_upload(&self, _: Request<GetUploadRequest>) -> Reply<GetUploadResponse> {
        let store = self.store();
        let (start, bytes) = store.open.as_ref().ok_or_else(|| Status::not_found("no such upload"))?;
        Ok(Response::new(GetUploadResponse { committed_size: bytes.len() as u64, size_bytes: start.size_bytes }))
    }

    async fn finish_upload(&self, _: Request<FinishUploadRequest>) -> Reply<FinishUploadResponse> {
        let lost = self.meets(Fault::FinishAnswerLost);
        let mut store = self.store();
        let (start, bytes) = store.open.take().ok_or_else(|| Status::not_found("no such upload"))?;
        assert_eq!(blake3::hash(&bytes).to_hex().to_string(), start.blake3);
        let episode = Episode { id: "ep_1".into(), file_name: start.file_name, ..Episode::default() };
        store.stored = Some((episode.clone(), bytes));
        if lost {
            return Err(Status::unavailable("going down"));
        }
        Ok(Response::new(FinishUploadResponse { episode: Some(episode), report: Some(Report::default()) }))
    }

    async fn get_episode(&self, _: Request<GetEpisodeRequest>) -> Reply<GetEpisodeResponse> {
        Err(Status::failed_precondition("this fake takes uploads only"))
    }

    async fn list_episodes(&self, _: Request<ListEpisodesRequest>) -> Reply<ListEpisodesResponse> {
        Err(Status::failed_precondition("this fake takes uploads only"))
    }

    async fn label_episodes(&self, _: Request<LabelEpisodesRequest>) -> Reply<LabelEpisodesResponse> {
        Err(Status::failed_precondition("this fake takes uploads only"))
    }

    async fn delete_episodes(&self, _: Request<DeleteEpisodesRequest>) -> Reply<DeleteEpisodesResponse> {
        Err(Status::failed_precondition("this fake takes uploads only"))
    }

    async fn undelete_episodes(&self, _: Request<UndeleteEpisodesRequest>) -> Reply<UndeleteEpisodesResponse> {
        Err(Status::failed_precondition("this fake takes uploads only"))
    }

    async fn list_labels(&self, _: Request<ListLabelsRequest>) -> Reply<ListLabelsResponse> {
        Err(Status::failed_precondition("this fake takes uploads only"))
    }

    type DownloadEpisodeStream =
        Pin<Box<dyn Stream<Item = std::result::Result<DownloadEpisodeResponse, Status>> + Send>>;

    async fn download_episode(&self, _: Request<DownloadEpisodeRequest>) -> Reply<Self::DownloadEpisodeStream> {
        Err(Status::failed_precondition("this fake takes uploads only"))
    }
}

// Two and a half messages.
fn recording() -> Vec<u8> {
    (0..PIECE * 5 / 2).map(|i| u8::try_from(i % 251).unwrap()).collect()
}

fn label() -> UploadLabel {
    UploadLabel { outcome: Outcome::Failure, cohort: "noise".into(), author: "me".into() }
}

/// A client of the fake, and the task that serves it.
async fn connected(fake: &Fake) -> (Client, tokio::task::JoinHandle<std::result::Result<(), tonic::transport::Error>>) {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let server = tonic::transport::Server::builder().add_service(EpisodeServiceServer::new(fake.clone()));
    let serving = tokio::spawn(server.serve_with_incoming(TcpListenerStream::new(listener)));
    (Client::connect(&url, None).await.unwrap(), serving)
}

async fn upload_through(faults: &[Fault]) -> (Result<Uploaded>, Fake) {
    let fake = Fake::default();
    fake.store().faults.extend(faults);
    let (client, serving) = connected(&fake).await;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, recording()).unwrap();
    let uploaded = client.upload("pick", &path, &label(), |_| {}).await;
    serving.abort();
    (uploaded, fake)
}

#[tokio::test]
async fn an_undisturbed_upload_sends_each_byte_once() {
    let (uploaded, fake) = upload_through(&[]).await;
    let uploaded = uploaded.unwrap();
    assert_eq!((uploaded.episode.id.as_str(), uploaded.existed), ("ep_1", false));
    assert!(uploaded.report.is_some());
    assert_eq!(fake.store().offsets, [0, PIECE as u64, 2 * PIECE as u64]);
    assert_eq!(fake.store().stored.as_ref().unwrap().1, recording());
}

#[tokio::test]
async fn a_broken_write_resumes_at_the_committed_size() {
    let (uploaded, fake) = upload_through(&[Fault::WriteBreaks, Fault::WriteBreaks]).await;
    assert_eq!(uploaded.unwrap().episode.id, "ep_1");
    let mut offsets = fake.store().offsets.clone();
    offsets.dedup();
    assert_eq!(offsets, [0, PIECE as u64, 2 * PIECE as u64], "no piece is sent twice");
    assert_eq!(fake.store().stored.as_ref().unwrap().1, recording());
}

#[tokio::test]
async fn a_lost_upload_is_restarted() {
    let (uploaded, fake) = upload_through(&[Fault::Forgets]).await;
    assert_eq!(uploaded.unwrap().episode.id, "ep_1");
    assert_eq!(fake.store().stored.as_ref().unwrap().1, recording());
}

#[tokio::test]
async fn a_retry_after_a_lost_response_finds_the_stored_episode() {
    let (uploaded, _) = upload_through(&[Fault::FinishAnswerLost]).await;
    assert!(uploaded.unwrap().existed);
}

#[tokio::test]
async fn a_rejection_is_final() {
    let (uploaded, fake) = upload_through(&[Fault::Refuses]).await;
    let error = uploaded.unwrap_err();
    assert_eq!(error.code(), Some(Code::AlreadyExists));
    assert_eq!(error.to_string(), "the content is there as failure; relabel it");
    assert!(fake.store().offsets.is_empty());
}
