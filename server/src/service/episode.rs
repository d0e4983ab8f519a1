//! EpisodeService: recordings in, with their labels.

use futures::{StreamExt as _, TryStreamExt as _, stream::BoxStream};
use gleaner_proto::v1::{self, episode_service_server::EpisodeService};
use tonic::{Request, Response, Status, Streaming};

use super::Services;
use crate::{
    access::Caller,
    domain::access::Role,
    error::Result,
    telemetry::metrics,
    wire::{
        self,
        status::{from_error, from_peer},
    },
};

/// Serves episodes.
pub(crate) struct Episodes(pub(crate) Services);

impl Episodes {
    async fn start(&self, request: Request<v1::StartUploadRequest>) -> Result<v1::StartUploadResponse> {
        let (client, request) = (Caller::client_of(&request)?, request.into_inner());
        let task = self.0.store.task(&request.task).await?;
        let started = self.0.ingest.start(wire::upload::start_request(request, task.id, client)?).await?;
        Ok(wire::upload::start_response(started))
    }

    async fn write(&self, requests: Streaming<v1::WriteUploadRequest>) -> Result<v1::WriteUploadResponse> {
        let chunks = requests.map(|request| match request {
            Ok(request) => {
                metrics::uploaded(request.data.len());
                wire::upload::chunk(request)
            }
            // Nobody may be left to read this; what came is kept.
            Err(status) => Err(from_peer(status)),
        });
        Ok(v1::WriteUploadResponse { committed_size: self.0.ingest.write(chunks).await? })
    }

    async fn status(&self, id: &str) -> Result<v1::GetUploadResponse> {
        let upload = self.0.ingest.status(&wire::upload::upload_id(id)?).await?;
        Ok(wire::upload::upload_status(&upload))
    }

    async fn finish(&self, id: &str) -> Result<v1::FinishUploadResponse> {
        let inspected = self.0.ingest.finish(&wire::upload::upload_id(id)?).await?;
        self.0.jobs.labelled();
        let (episode, report) = wire::episode::inspected(inspected);
        Ok(v1::FinishUploadResponse { episode: Some(episode), report: Some(report) })
    }

    async fn get(&self, id: &str) -> Result<v1::GetEpisodeResponse> {
        let inspected = self.0.store.episode(&wire::episode::episode_id(id)?).await?;
        let (episode, report) = wire::episode::inspected(inspected);
        Ok(v1::GetEpisodeResponse { episode: Some(episode), report: Some(report) })
    }

    async fn list(&self, request: v1::ListEpisodesRequest) -> Result<v1::ListEpisodesResponse> {
        let task = self.0.store.task(&request.task).await?;
        let listing = wire::episode::list_request(request, task.id)?;
        let (episodes, next) = self.0.store.episodes(&listing.filter, listing.after.as_ref(), listing.size).await?;
        Ok(v1::ListEpisodesResponse {
            episodes: episodes.into_iter().map(wire::episode::episode).collect(),
            next_page_token: next.map(String::from).unwrap_or_default(),
        })
    }

    async fn label(&self, request: v1::LabelEpisodesRequest) -> Result<v1::LabelEpisodesResponse> {
        let (ids, label) = wire::episode::label_request(request)?;
        let episodes = self.0.store.label_episodes(&ids, &label).await?;
        self.0.jobs.labelled();
        Ok(v1::LabelEpisodesResponse { episodes: episodes.into_iter().map(wire::episode::episode).collect() })
    }

    async fn delete(&self, caller: &Caller, request: &v1::DeleteEpisodesRequest) -> Result<v1::DeleteEpisodesResponse> {
        let (ids, force) = wire::episode::delete_request(request)?;
        if force {
            // What others have made something from.
            caller.must_be(Role::Admin)?;
        }
        let episodes = self.0.store.delete_episodes(&ids, force).await?;
        tracing::info!(episode.count = episodes.len(), force, "episodes put into the trash");
        Ok(v1::DeleteEpisodesResponse { episodes: episodes.into_iter().map(wire::episode::episode).collect() })
    }

    async fn undelete(&self, request: &v1::UndeleteEpisodesRequest) -> Result<v1::UndeleteEpisodesResponse> {
        let episodes = self.0.store.undelete_episodes(&wire::episode::undelete_request(request)?).await?;
        self.0.jobs.labelled();
        Ok(v1::UndeleteEpisodesResponse { episodes: episodes.into_iter().map(wire::episode::episode).collect() })
    }

    async fn labels(&self, id: &str) -> Result<v1::ListLabelsResponse> {
        let labels = self.0.store.labels(&wire::episode::episode_id(id)?).await?;
        Ok(v1::ListLabelsResponse { labels: labels.into_iter().map(wire::episode::label).collect() })
    }

    async fn download(&self, id: &str) -> Result<BoxStream<'static, Result<v1::DownloadEpisodeResponse>>> {
        let episode = self.0.store.episode(&wire::episode::episode_id(id)?).await?.episode;
        let bytes = self.0.blobs.stream(&episode.recording).await?;
        Ok(bytes.map_ok(|data| v1::DownloadEpisodeResponse { data }).boxed())
    }
}

#[tonic::async_trait]
impl EpisodeService for Episodes {
    async fn start_upload(
        &self,
        request: Request<v1::StartUploadRequest>,
    ) -> tonic::Result<Response<v1::StartUploadResponse>> {
        self.start(request).await.map(Response::new).map_err(from_error)
    }

    async fn write_upload(
        &self,
        request: Request<Streaming<v1::WriteUploadRequest>>,
    ) -> tonic::Result<Response<v1::WriteUploadResponse>> {
        self.write(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn get_upload(
        &self,
        request: Request<v1::GetUploadRequest>,
    ) -> tonic::Result<Response<v1::GetUploadResponse>> {
        self.status(&request.into_inner().upload_id).await.map(Response::new).map_err(from_error)
    }

    #[tracing::instrument(name = "finish_upload", skip_all, fields(upload.id = request.get_ref().upload_id))]
    async fn finish_upload(
        &self,
        request: Request<v1::FinishUploadRequest>,
    ) -> tonic::Result<Response<v1::FinishUploadResponse>> {
        self.finish(&request.into_inner().upload_id).await.map(Response::new).map_err(from_error)
    }

    async fn get_episode(
        &self,
        request: Request<v1::GetEpisodeRequest>,
    ) -> tonic::Result<Response<v1::GetEpisodeResponse>> {
        self.get(&request.into_inner().episode_id).await.map(Response::new).map_err(from_error)
    }

    async fn list_episodes(
        &self,
        request: Request<v1::ListEpisodesRequest>,
    ) -> tonic::Result<Response<v1::ListEpisodesResponse>> {
        self.list(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn label_episodes(
        &self,
        request: Request<v1::LabelEpisodesRequest>,
    ) -> tonic::Result<Response<v1::LabelEpisodesResponse>> {
        self.label(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn list_labels(
        &self,
        request: Request<v1::ListLabelsRequest>,
    ) -> tonic::Result<Response<v1::ListLabelsResponse>> {
        self.labels(&request.into_inner().episode_id).await.map(Response::new).map_err(from_error)
    }

    async fn delete_episodes(
        &self,
        request: Request<v1::DeleteEpisodesRequest>,
    ) -> tonic::Result<Response<v1::DeleteEpisodesResponse>> {
        let caller = Caller::of(&request).map_err(from_error)?;
        self.delete(&caller, request.get_ref()).await.map(Response::new).map_err(from_error)
    }

    async fn undelete_episodes(
        &self,
        request: Request<v1::UndeleteEpisodesRequest>,
    ) -> tonic::Result<Response<v1::UndeleteEpisodesResponse>> {
        self.undelete(request.get_ref()).await.map(Response::new).map_err(from_error)
    }

    type DownloadEpisodeStream = BoxStream<'static, std::result::Result<v1::DownloadEpisodeResponse, Status>>;

    async fn download_episode(
        &self,
        request: Request<v1::DownloadEpisodeRequest>,
    ) -> tonic::Result<Response<Self::DownloadEpisodeStream>> {
        let stream = self.download(&request.into_inner().episode_id).await.map_err(from_error)?;
        Ok(Response::new(stream.map_err(from_error).boxed()))
    }
}
