//! DatasetService: filtered views of score runs, their segments and exports.

use futures::{StreamExt as _, TryStreamExt as _, stream::BoxStream};
use gleaner_proto::v1::{self, dataset_service_server::DatasetService};
use tonic::{Request, Response};

use super::{Services, segment};
use crate::{
    domain::dataset::Dataset,
    error::Result,
    wire::{self, status::from_error},
};

/// Serves datasets.
pub(crate) struct Datasets(pub(crate) Services);

impl Datasets {
    async fn create(&self, request: v1::CreateDatasetRequest) -> Result<v1::CreateDatasetResponse> {
        let (run, selection) = wire::dataset::create_request(request)?;
        let dataset = self.0.store.insert_dataset(&run, selection).await?;
        Ok(v1::CreateDatasetResponse { dataset: self.counted(vec![dataset]).await?.pop() })
    }

    async fn get(&self, id: &str) -> Result<v1::GetDatasetResponse> {
        let dataset = self.0.store.dataset(&wire::dataset::dataset_id(id)?).await?;
        Ok(v1::GetDatasetResponse { dataset: self.counted(vec![dataset]).await?.pop() })
    }

    async fn list(&self, task: &str) -> Result<v1::ListDatasetsResponse> {
        let task = self.0.store.task(task).await?;
        let datasets = self.0.store.datasets(&task.id).await?;
        Ok(v1::ListDatasetsResponse { datasets: self.counted(datasets).await? })
    }

    async fn counted(&self, datasets: Vec<Dataset>) -> Result<Vec<v1::Dataset>> {
        let counts = self.0.store.dataset_counts(&datasets).await?;
        Ok(datasets.into_iter().zip(counts).map(|(dataset, counts)| wire::dataset::dataset(dataset, counts)).collect())
    }

    async fn segments(
        &self,
        request: v1::StreamSegmentsRequest,
    ) -> Result<BoxStream<'static, tonic::Result<v1::StreamSegmentsResponse>>> {
        let segments = segment::segments(&self.0, wire::dataset::segments_request(request)?).await?;
        let responses = segments.map_ok(|segment| v1::StreamSegmentsResponse { segment: Some(segment) });
        Ok(responses.map_err(from_error).boxed())
    }

    async fn files(&self, id: &str) -> Result<v1::ListExportFilesResponse> {
        let files = self.0.store.export_files(&wire::dataset::export_id(id)?).await?;
        Ok(v1::ListExportFilesResponse { files: files.into_iter().map(wire::dataset::export_file).collect() })
    }

    async fn download(
        &self,
        request: v1::DownloadExportFileRequest,
    ) -> Result<BoxStream<'static, tonic::Result<v1::DownloadExportFileResponse>>> {
        let (export, name) = wire::dataset::download_request(request)?;
        let file = self.0.store.export_file(&export, &name).await?;
        let chunks = self.0.blobs.stream(&file.blob).await?;
        Ok(chunks.map_ok(|data| v1::DownloadExportFileResponse { data }).map_err(from_error).boxed())
    }
}

#[tonic::async_trait]
impl DatasetService for Datasets {
    type StreamSegmentsStream = BoxStream<'static, tonic::Result<v1::StreamSegmentsResponse>>;
    type DownloadExportFileStream = BoxStream<'static, tonic::Result<v1::DownloadExportFileResponse>>;

    async fn create_dataset(
        &self,
        request: Request<v1::CreateDatasetRequest>,
    ) -> tonic::Result<Response<v1::CreateDatasetResponse>> {
        self.create(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn get_dataset(
        &self,
        request: Request<v1::GetDatasetRequest>,
    ) -> tonic::Result<Response<v1::GetDatasetResponse>> {
        let v1::GetDatasetRequest { dataset_id } = request.into_inner();
        self.get(&dataset_id).await.map(Response::new).map_err(from_error)
    }

    async fn list_datasets(
        &self,
        request: Request<v1::ListDatasetsRequest>,
    ) -> tonic::Result<Response<v1::ListDatasetsResponse>> {
        let v1::ListDatasetsRequest { task } = request.into_inner();
        self.list(&task).await.map(Response::new).map_err(from_error)
    }

    async fn stream_segments(
        &self,
        request: Request<v1::StreamSegmentsRequest>,
    ) -> tonic::Result<Response<Self::StreamSegmentsStream>> {
        self.segments(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn list_export_files(
        &self,
        request: Request<v1::ListExportFilesRequest>,
    ) -> tonic::Result<Response<v1::ListExportFilesResponse>> {
        let v1::ListExportFilesRequest { export_id } = request.into_inner();
        self.files(&export_id).await.map(Response::new).map_err(from_error)
    }

    async fn download_export_file(
        &self,
        request: Request<v1::DownloadExportFileRequest>,
    ) -> tonic::Result<Response<Self::DownloadExportFileStream>> {
        self.download(request.into_inner()).await.map(Response::new).map_err(from_error)
    }
}
