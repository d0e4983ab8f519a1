//! Datasets, segments and exports on the wire.

use gleaner_proto::v1;

use super::{field, page, score, selection};
use crate::{
    dataset::{Dataset, DatasetCounts, ExportFile},
    error::Result,
    id::{DatasetId, ExportId, ScoreRunId},
    page::Page,
    selection::{Rule, SelectionShape},
};

/// The parts of a dataset to stream.
pub struct SegmentsRequest {
    /// The dataset.
    pub dataset_id: DatasetId,
    /// Whether the frames are sent too.
    pub include_frames: bool,
    /// Whether only kept segments are sent.
    pub kept_only: bool,
}

/// Reads the id of a dataset.
///
/// # Errors
/// Invalid names the field.
pub fn dataset_id(text: &str) -> Result<DatasetId> {
    DatasetId::parse("dataset_id", text)
}

/// Reads the id of an export.
///
/// # Errors
/// Invalid names the field.
pub fn export_id(text: &str) -> Result<ExportId> {
    ExportId::parse("export_id", text)
}

/// The task's name or id, and the page of its datasets.
///
/// # Errors
/// Invalid names the field.
pub fn list_request(request: v1::ListDatasetsRequest) -> Result<(String, Page<DatasetId>)> {
    let v1::ListDatasetsRequest { task, page_size, page_token } = request;
    Ok((task, page::page_by_id(page_size, &page_token)?))
}

/// The first part of a token of a page of files, whose second is the place of a file in its export.
const FILE: &str = "file";

/// The export, and the page of its files.
///
/// # Errors
/// Invalid names the field.
pub fn files_request(request: v1::ListExportFilesRequest) -> Result<(ExportId, Page<u32>)> {
    let v1::ListExportFilesRequest { export_id: id, page_size, page_token } = request;
    let place = |token: &str| page::named_key(FILE, token)?.parse().ok();
    Ok((export_id(&id)?, page::page(page_size, &page_token, place)?))
}

/// The token of the page of files behind a place; empty behind the last page.
pub fn files_token(next: Option<u32>) -> String {
    page::token(next.map(|place| page::named_token(FILE, place)))
}

/// Reads the score run of a new dataset, its rule if there is one, and its shape.
///
/// # Errors
/// Invalid names the field.
pub fn create_request(request: v1::CreateDatasetRequest) -> Result<(ScoreRunId, Option<Rule>, SelectionShape)> {
    let v1::CreateDatasetRequest { score_run_id, selection } = request;
    let run = score::score_run_id(&score_run_id)?;
    let (rule, shape) = selection::parts_from_proto("selection", selection)?;
    Ok((run, rule, shape))
}

/// Reads which segments to stream.
///
/// # Errors
/// Invalid names the field.
pub fn segments_request(request: v1::StreamSegmentsRequest) -> Result<SegmentsRequest> {
    let v1::StreamSegmentsRequest { dataset_id: id, include_frames, kept_only } = request;
    Ok(SegmentsRequest { dataset_id: dataset_id(&id)?, include_frames, kept_only })
}

/// Reads the export, the name of one of its files, and whether a URL is accepted.
///
/// # Errors
/// Invalid names the field.
pub fn download_request(request: v1::DownloadExportFileRequest) -> Result<(ExportId, String, bool)> {
    let v1::DownloadExportFileRequest { export_id: id, name, accept_url } = request;
    Ok((export_id(&id)?, field::text("name", name)?, accept_url))
}

/// A dataset with its counts, if they are known.
pub fn dataset(dataset: Dataset, counts: Option<DatasetCounts>) -> v1::Dataset {
    let Dataset { id, task_id, score_run_id, selection, created_at } = dataset;
    v1::Dataset {
        id: id.into(),
        task_id: task_id.into(),
        score_run_id: score_run_id.into(),
        selection: Some(selection::selection_to_proto(selection)),
        kept_segments: counts.map(|counts| counts.kept_segments),
        kept_episodes: counts.map(|counts| counts.kept_episodes),
        expert_segments: counts.map(|counts| counts.expert_segments),
        create_time: Some(field::timestamp(created_at)),
    }
}

/// A file of an export.
pub fn export_file(file: ExportFile) -> v1::ExportFile {
    let ExportFile { name, blob, size_bytes } = file;
    v1::ExportFile { name, size_bytes, blake3: blob.into() }
}
