//! Check of a recording: what the server would do with it, before any byte is sent.

use gleaner_proto::v1::{Episode, InspectionEstimate, StartUploadRequest, StartUploadResponse};
use gleaner_recording::RecordingSummary;

use crate::connection::Client;
use crate::error::Result;
use crate::push::PushItem;
use crate::source::Source;
use crate::upload::start_request;

/// A recording that the server would accept for upload.
#[derive(Clone, Debug)]
pub struct Checked {
    /// Size in bytes.
    pub size_bytes: u64,
    /// What the recording states about itself; `None` without a sound summary section.
    pub summary: Option<RecordingSummary>,
    /// What its inspection takes; `None` without a summary.
    pub estimate: Option<InspectionEstimate>,
    /// The episode, if the task already holds this content under this label.
    pub existing: Option<Episode>,
}

impl Client {
    /// Checks a recording as [`Client::push`] would, and sends none of its bytes. The server may still reject it when it
    /// is inspected.
    ///
    /// # Errors
    /// As for [`Client::upload`], before its first byte.
    pub async fn check(&self, item: &PushItem) -> Result<Checked> {
        let PushItem { path, parts, task, label } = item;
        let declared = Source::of(path, parts)?.declare().await?;
        let (size_bytes, summary) = (declared.digest.size_bytes, declared.summary.clone());
        let request = StartUploadRequest { validate_only: true, ..start_request(task, declared, label) };
        let StartUploadResponse { existing, estimate, .. } = self.episodes().start_upload(request).await?.into_inner();
        Ok(Checked { size_bytes, summary, estimate, existing })
    }
}
