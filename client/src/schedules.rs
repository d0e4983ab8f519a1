//! The schedules of a server, read page by page.

use gleaner_proto::v1::{ListSchedulesRequest, ListSchedulesResponse};

use crate::connection::Client;
use crate::error::Result;

/// The schedules of one page.
const PAGE: u32 = 1000;

impl Client {
    /// Every schedule of a task, or of the server with an empty `task`, oldest first, as one page.
    ///
    /// # Errors
    /// [`crate::ClientError::Rejected`] when there is no such task.
    pub async fn every_schedule(&self, task: &str) -> Result<ListSchedulesResponse> {
        let mut request = ListSchedulesRequest { task: task.to_owned(), page_size: PAGE, page_token: String::new() };
        let mut whole = ListSchedulesResponse::default();
        loop {
            let page = self.schedules().list_schedules(request.clone()).await?.into_inner();
            whole.schedules.extend(page.schedules);
            if page.next_page_token.is_empty() {
                return Ok(whole);
            }
            request.page_token = page.next_page_token;
        }
    }
}
