//! Uploads on the wire.

use gleaner_core::{
    InspectionEstimate,
    proto::recording::{estimate_to_proto, summary_from_proto},
};
use gleaner_proto::v1;

use super::{
    episode::{episode, required_outcome},
    field,
};
use crate::{
    domain::{
        client::Client,
        episode::{Episode, NewUpload, Upload},
        id::{BlobId, TaskId, UploadId},
    },
    error::{Error, Result},
    ingest::{Chunk, Started},
};

/// Most bytes in one message of an upload.
const CHUNK_BYTES: usize = 2 << 20;

/// Reads an upload's id.
pub(crate) fn upload_id(text: &str) -> Result<UploadId> {
    UploadId::parse("upload_id", text)
}

/// Reads the declaration of an upload to the task. The outcome is required; `unknown` is one.
pub(crate) fn start_request(request: v1::StartUploadRequest, task_id: TaskId, client: Client) -> Result<NewUpload> {
    let v1::StartUploadRequest {
        task: _,
        file_name,
        size_bytes,
        blake3,
        outcome,
        cohort,
        author,
        summary,
        validate_only: _,
    } = request;
    if size_bytes == 0 {
        return Err(Error::invalid("size_bytes", "the file is empty; record the episode again or push the right file"));
    }
    Ok(NewUpload {
        task_id,
        file_name: field::text("file_name", file_name)?,
        size_bytes,
        blake3: BlobId::parse("blake3", &blake3)?,
        outcome: required_outcome(outcome)?,
        cohort: field::tag("cohort", cohort)?,
        author: field::tag("author", author)?,
        client,
        summary: summary.map(summary_from_proto),
    })
}

/// How an upload started.
pub(crate) fn start_response(started: Started) -> v1::StartUploadResponse {
    match started {
        Started::Open(upload) => v1::StartUploadResponse {
            upload_id: upload.id.into(),
            committed_size: upload.committed,
            ..Default::default()
        },
        Started::Existing(existing) => existing_response(existing),
    }
}

/// What a checked upload would do.
pub(crate) fn check_response(
    existing: Option<Episode>,
    estimate: Option<InspectionEstimate>,
) -> v1::StartUploadResponse {
    let response = existing.map(existing_response).unwrap_or_default();
    v1::StartUploadResponse { estimate: estimate.map(estimate_to_proto), ..response }
}

fn existing_response(existing: Episode) -> v1::StartUploadResponse {
    let committed_size = existing.size_bytes;
    v1::StartUploadResponse { committed_size, existing: Some(episode(existing)), ..Default::default() }
}

/// Some bytes of an upload.
pub(crate) fn chunk(request: v1::WriteUploadRequest) -> Result<Chunk> {
    let v1::WriteUploadRequest { upload_id: id, offset, data } = request;
    if data.len() > CHUNK_BYTES {
        return Err(Error::invalid(
            "data",
            format!("{} bytes are too many: send at most {CHUNK_BYTES} a message", data.len()),
        ));
    }
    let upload_id = if id.is_empty() { None } else { Some(upload_id(&id)?) };
    Ok(Chunk { upload_id, offset, data })
}

/// How far an upload is.
pub(crate) fn upload_status(upload: &Upload) -> v1::GetUploadResponse {
    v1::GetUploadResponse { committed_size: upload.committed, size_bytes: upload.size_bytes }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chunk_is_at_most_two_mebibytes() {
        let request = |size| v1::WriteUploadRequest { data: vec![0; size].into(), ..Default::default() };
        assert!(chunk(request(CHUNK_BYTES)).unwrap().upload_id.is_none());
        assert!(chunk(request(CHUNK_BYTES + 1)).unwrap_err().message().starts_with("data: "));
    }

    #[test]
    fn an_empty_file_is_refused_before_it_is_sent() {
        let request = v1::StartUploadRequest { file_name: "a.mcap".into(), ..Default::default() };
        assert!(
            start_request(request, TaskId::new(), Client::Server).unwrap_err().message().starts_with("size_bytes: ")
        );
    }
}
