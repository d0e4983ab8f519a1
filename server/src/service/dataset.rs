//! DatasetService: filtered views of score runs, their segments and exports.

use futures::TryStreamExt as _;
use gleaner_proto::v1::{self, dataset_service_server::DatasetService};
use tonic::Request;

use super::{
    Services,
    answer::{Reply, Responses, answer, change, responses},
    segment,
};
use crate::{
    domain::{
        dataset::Dataset,
        selection::{Rule, Selection},
    },
    error::Result,
    wire,
};

/// Serves datasets.
pub(crate) struct DatasetApi(pub(crate) Services);

impl DatasetApi {
    async fn counted(&self, datasets: Vec<Dataset>) -> Result<Vec<v1::Dataset>> {
        let counts = self.0.curation.dataset_counts(&datasets).await?;
        Ok(datasets.into_iter().zip(counts).map(|(dataset, counts)| wire::dataset::dataset(dataset, counts)).collect())
    }
}

#[tonic::async_trait]
impl DatasetService for DatasetApi {
    type StreamSegmentsStream = Responses<v1::StreamSegmentsResponse>;
    type DownloadExportFileStream = Responses<v1::DownloadExportFileResponse>;

    async fn create_dataset(&self, request: Request<v1::CreateDatasetRequest>) -> Reply<v1::CreateDatasetResponse> {
        change(request, async |request| {
            let (run, rule, shape) = wire::dataset::create_request(request)?;
            let rule = match rule {
                Some(rule) => rule,
                None => Rule::Beta(self.0.store.default_beta(&run).await?),
            };
            let selection = Selection { rule, shape };
            let dataset = self.0.store.insert_dataset(&run, selection).await?;
            Ok(v1::CreateDatasetResponse { dataset: self.counted(vec![dataset]).await?.pop() })
        })
        .await
    }

    async fn get_dataset(&self, request: Request<v1::GetDatasetRequest>) -> Reply<v1::GetDatasetResponse> {
        answer(async {
            let dataset = self.0.store.dataset(&wire::dataset::dataset_id(&request.get_ref().dataset_id)?).await?;
            Ok(v1::GetDatasetResponse { dataset: self.counted(vec![dataset]).await?.pop() })
        })
        .await
    }

    async fn list_datasets(&self, request: Request<v1::ListDatasetsRequest>) -> Reply<v1::ListDatasetsResponse> {
        answer(async {
            let (task, page) = wire::dataset::list_request(request.into_inner())?;
            let task = self.0.store.task(&task).await?;
            let (datasets, next) = self.0.store.datasets_page(&task.id, &page).await?;
            let datasets = self.counted(datasets).await?;
            Ok(v1::ListDatasetsResponse { datasets, next_page_token: wire::page::token(next) })
        })
        .await
    }

    async fn stream_segments(&self, request: Request<v1::StreamSegmentsRequest>) -> Reply<Self::StreamSegmentsStream> {
        answer(async {
            let request = wire::dataset::segments_request(request.into_inner())?;
            let segments = segment::segments(&self.0, request).await?;
            Ok(responses(segments.map_ok(|segment| v1::StreamSegmentsResponse { segment: Some(segment) })))
        })
        .await
    }

    async fn list_export_files(
        &self,
        request: Request<v1::ListExportFilesRequest>,
    ) -> Reply<v1::ListExportFilesResponse> {
        answer(async {
            let (export, page) = wire::dataset::files_request(request.into_inner())?;
            let (files, next) = self.0.store.export_files_page(&export, &page).await?;
            let files = files.into_iter().map(wire::dataset::export_file).collect();
            Ok(v1::ListExportFilesResponse { files, next_page_token: wire::dataset::files_token(next) })
        })
        .await
    }

    async fn download_export_file(
        &self,
        request: Request<v1::DownloadExportFileRequest>,
    ) -> Reply<Self::DownloadExportFileStream> {
        answer(async {
            let (export, name, accept_url) = wire::dataset::download_request(request.into_inner())?;
            let file = self.0.store.export_file(&export, &name).await?;
            let message = |data, url| v1::DownloadExportFileResponse { data, url };
            self.0.download(&file.blob, accept_url, message).await
        })
        .await
    }
}
