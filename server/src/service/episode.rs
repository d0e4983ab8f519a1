//! EpisodeService: recordings in, with their labels.

use futures::StreamExt as _;
use gleaner_proto::v1::{self, episode_service_server::EpisodeService};
use tonic::{Request, Streaming};

use super::{
    Services,
    answer::{Reply, Responses, answer, change, change_by},
};
use crate::{
    access::Caller,
    domain::access::Role,
    telemetry::metrics,
    wire::{self, status::from_peer},
};

/// Serves episodes.
pub(crate) struct EpisodeApi(pub(crate) Services);

#[tonic::async_trait]
impl EpisodeService for EpisodeApi {
    async fn start_upload(&self, request: Request<v1::StartUploadRequest>) -> Reply<v1::StartUploadResponse> {
        let client = Caller::client_of(&request);
        if request.get_ref().validate_only {
            return answer(async {
                let request = request.into_inner();
                let task = self.0.store.task(&request.task).await?;
                let new = wire::upload::start_request(request, task.id, client?)?;
                let (existing, estimate) = self.0.ingest.check(new).await?;
                Ok(wire::upload::check_response(existing, estimate))
            })
            .await;
        }
        change(request, async |request| {
            let task = self.0.store.task(&request.task).await?;
            let started = self.0.ingest.start(wire::upload::start_request(request, task.id, client?)?).await?;
            Ok(wire::upload::start_response(started))
        })
        .await
    }

    async fn write_upload(
        &self,
        request: Request<Streaming<v1::WriteUploadRequest>>,
    ) -> Reply<v1::WriteUploadResponse> {
        change_by(request, async |audit, requests| {
            let chunks = requests.enumerate().map(move |(at, request)| match request {
                Ok(request) => {
                    if at == 0 {
                        audit.about(&request);
                    }
                    metrics::uploaded(request.data.len());
                    wire::upload::chunk(request)
                }
                // The caller may be gone and not read this; the bytes so far are kept.
                Err(status) => Err(from_peer(status)),
            });
            Ok(v1::WriteUploadResponse { committed_size: self.0.ingest.write(chunks).await? })
        })
        .await
    }

    async fn get_upload(&self, request: Request<v1::GetUploadRequest>) -> Reply<v1::GetUploadResponse> {
        answer(async {
            let upload = self.0.ingest.status(&wire::upload::upload_id(&request.get_ref().upload_id)?).await?;
            Ok(wire::upload::upload_status(&upload))
        })
        .await
    }

    #[tracing::instrument(name = "finish_upload", skip_all, fields(upload.id = request.get_ref().upload_id))]
    async fn finish_upload(&self, request: Request<v1::FinishUploadRequest>) -> Reply<v1::FinishUploadResponse> {
        change(request, async |v1::FinishUploadRequest { upload_id }| {
            let inspected = self.0.ingest.finish(&wire::upload::upload_id(&upload_id)?).await?;
            self.0.jobs.labelled();
            let (episode, report) = wire::episode::inspected(inspected);
            Ok(v1::FinishUploadResponse { episode: Some(episode), report: Some(report) })
        })
        .await
    }

    async fn get_episode(&self, request: Request<v1::GetEpisodeRequest>) -> Reply<v1::GetEpisodeResponse> {
        answer(async {
            let id = wire::episode::episode_id(&request.get_ref().episode_id)?;
            let (episode, report) = wire::episode::inspected(self.0.store.episode(&id).await?);
            Ok(v1::GetEpisodeResponse { episode: Some(episode), report: Some(report) })
        })
        .await
    }

    async fn list_episodes(&self, request: Request<v1::ListEpisodesRequest>) -> Reply<v1::ListEpisodesResponse> {
        answer(async {
            let task = self.0.store.task(&request.get_ref().task).await?;
            let listing = wire::episode::list_request(request.into_inner(), task.id)?;
            let (episodes, next) = self.0.store.episodes(&listing.filter, listing.after.as_ref(), listing.size).await?;
            Ok(v1::ListEpisodesResponse {
                episodes: episodes.into_iter().map(wire::episode::episode).collect(),
                next_page_token: next.map(String::from).unwrap_or_default(),
            })
        })
        .await
    }

    async fn label_episodes(&self, request: Request<v1::LabelEpisodesRequest>) -> Reply<v1::LabelEpisodesResponse> {
        change(request, async |request| {
            let (ids, label) = wire::episode::label_request(request)?;
            let episodes = self.0.store.label_episodes(&ids, &label).await?;
            self.0.jobs.labelled();
            Ok(v1::LabelEpisodesResponse { episodes: episodes.into_iter().map(wire::episode::episode).collect() })
        })
        .await
    }

    async fn list_labels(&self, request: Request<v1::ListLabelsRequest>) -> Reply<v1::ListLabelsResponse> {
        answer(async {
            let (episode, page) = wire::episode::labels_request(request.into_inner())?;
            let (labels, next) = self.0.store.labels_page(&episode, &page).await?;
            let labels = labels.into_iter().map(wire::episode::label).collect();
            Ok(v1::ListLabelsResponse { labels, next_page_token: wire::episode::labels_token(next) })
        })
        .await
    }

    async fn delete_episodes(&self, request: Request<v1::DeleteEpisodesRequest>) -> Reply<v1::DeleteEpisodesResponse> {
        let caller = Caller::of(&request);
        change(request, async |request| {
            let (ids, force) = wire::episode::delete_request(&request)?;
            if force {
                // Others have made snapshots and datasets from them.
                caller?.must_be(Role::Admin)?;
            }
            let episodes = self.0.store.delete_episodes(&ids, force).await?;
            tracing::info!(episode.count = episodes.len(), force, "episodes put into the trash");
            Ok(v1::DeleteEpisodesResponse { episodes: episodes.into_iter().map(wire::episode::episode).collect() })
        })
        .await
    }

    async fn undelete_episodes(
        &self,
        request: Request<v1::UndeleteEpisodesRequest>,
    ) -> Reply<v1::UndeleteEpisodesResponse> {
        change(request, async |request| {
            let episodes = self.0.store.undelete_episodes(&wire::episode::undelete_request(&request)?).await?;
            self.0.jobs.labelled();
            Ok(v1::UndeleteEpisodesResponse { episodes: episodes.into_iter().map(wire::episode::episode).collect() })
        })
        .await
    }

    type DownloadEpisodeStream = Responses<v1::DownloadEpisodeResponse>;

    async fn download_episode(
        &self,
        request: Request<v1::DownloadEpisodeRequest>,
    ) -> Reply<Self::DownloadEpisodeStream> {
        answer(async {
            let v1::DownloadEpisodeRequest { episode_id, accept_url } = request.into_inner();
            let id = wire::episode::episode_id(&episode_id)?;
            let episode = self.0.store.episode(&id).await?.episode;
            let message = |data, url| v1::DownloadEpisodeResponse { data, url };
            self.0.download(&episode.recording, accept_url, message).await
        })
        .await
    }
}
