//! Every row of a list, read page by page.

use gleaner_proto::v1::{
    ListDatasetsRequest, ListDatasetsResponse, ListDeploymentsRequest, ListDeploymentsResponse, ListEvaluationsRequest,
    ListEvaluationsResponse, ListExportFilesRequest, ListExportFilesResponse, ListLabelsRequest, ListLabelsResponse,
    ListPoliciesRequest, ListPoliciesResponse, ListSchedulesRequest, ListSchedulesResponse, ListScoreRunsRequest,
    ListScoreRunsResponse, ListSnapshotsRequest, ListSnapshotsResponse, ListTasksRequest, ListTasksResponse,
};

use crate::connection::Client;
use crate::error::Result;

/// The rows of one page.
const PAGE: u32 = 1000;

/// The rows of one page where a row can take kilobytes: the specification of a task, the inputs of a policy, the history
/// of a deployment, the seeds of an evaluation.
const PAGE_OF_LARGE_ROWS: u32 = 100;

/// Sends a request until no page is left; returns all of them as one.
macro_rules! every_page {
    ($service:expr, $list:ident, $request:expr, $response:ident { $rows:ident }) => {{
        let mut request = $request;
        let mut whole = $response::default();
        loop {
            let page = $service.$list(request.clone()).await?.into_inner();
            whole.$rows.extend(page.$rows);
            if page.next_page_token.is_empty() {
                return Ok(whole);
            }
            request.page_token = page.next_page_token;
        }
    }};
}

impl Client {
    /// Every task, oldest first, as one page.
    ///
    /// # Errors
    /// [`crate::ClientError::Rejected`] with the server's reason.
    pub async fn every_task(&self) -> Result<ListTasksResponse> {
        let request = ListTasksRequest { page_size: PAGE_OF_LARGE_ROWS, page_token: String::new() };
        every_page!(self.tasks(), list_tasks, request, ListTasksResponse { tasks })
    }

    /// Every label that an episode ever had, oldest first, as one page.
    ///
    /// # Errors
    /// [`crate::ClientError::Rejected`] when there is no such episode.
    pub async fn every_label(&self, episode_id: &str) -> Result<ListLabelsResponse> {
        let request =
            ListLabelsRequest { episode_id: episode_id.to_owned(), page_size: PAGE, page_token: String::new() };
        every_page!(self.episodes(), list_labels, request, ListLabelsResponse { labels })
    }

    /// Every snapshot of a task, newest first, as one page.
    ///
    /// # Errors
    /// [`crate::ClientError::Rejected`] when there is no such task.
    pub async fn every_snapshot(&self, task: &str) -> Result<ListSnapshotsResponse> {
        let request = ListSnapshotsRequest { task: task.to_owned(), page_size: PAGE, page_token: String::new() };
        every_page!(self.snapshots(), list_snapshots, request, ListSnapshotsResponse { snapshots })
    }

    /// Every schedule of a task, or of the server with an empty `task`, oldest first, as one page.
    ///
    /// # Errors
    /// [`crate::ClientError::Rejected`] when there is no such task.
    pub async fn every_schedule(&self, task: &str) -> Result<ListSchedulesResponse> {
        let request = ListSchedulesRequest { task: task.to_owned(), page_size: PAGE, page_token: String::new() };
        every_page!(self.schedules(), list_schedules, request, ListSchedulesResponse { schedules })
    }

    /// Every finished score run of a task, newest first, as one page.
    ///
    /// # Errors
    /// [`crate::ClientError::Rejected`] when there is no such task.
    pub async fn every_score_run(&self, task: &str) -> Result<ListScoreRunsResponse> {
        let request = ListScoreRunsRequest { task: task.to_owned(), page_size: PAGE, page_token: String::new() };
        every_page!(self.scores(), list_score_runs, request, ListScoreRunsResponse { score_runs })
    }

    /// Every dataset of a task, newest first, as one page.
    ///
    /// # Errors
    /// [`crate::ClientError::Rejected`] when there is no such task.
    pub async fn every_dataset(&self, task: &str) -> Result<ListDatasetsResponse> {
        let request = ListDatasetsRequest { task: task.to_owned(), page_size: PAGE, page_token: String::new() };
        every_page!(self.datasets(), list_datasets, request, ListDatasetsResponse { datasets })
    }

    /// Every file of a finished export, in order, as one page.
    ///
    /// # Errors
    /// The codes of `ListExportFiles`.
    pub async fn every_export_file(&self, export_id: &str) -> Result<ListExportFilesResponse> {
        let request =
            ListExportFilesRequest { export_id: export_id.to_owned(), page_size: PAGE, page_token: String::new() };
        every_page!(self.datasets(), list_export_files, request, ListExportFilesResponse { files })
    }

    /// Every policy of a task, newest first, as one page.
    ///
    /// # Errors
    /// [`crate::ClientError::Rejected`] when there is no such task.
    pub async fn every_policy(&self, task: &str) -> Result<ListPoliciesResponse> {
        let (task, page_size) = (task.to_owned(), PAGE_OF_LARGE_ROWS);
        let request = ListPoliciesRequest { task, page_size, page_token: String::new() };
        every_page!(self.policies(), list_policies, request, ListPoliciesResponse { policies })
    }

    /// Every deployment of a task, or of the server with an empty `task`, by name, as one page.
    ///
    /// # Errors
    /// [`crate::ClientError::Rejected`] when there is no such task.
    pub async fn every_deployment(&self, task: &str) -> Result<ListDeploymentsResponse> {
        let (task, page_size) = (task.to_owned(), PAGE_OF_LARGE_ROWS);
        let request = ListDeploymentsRequest { task, page_size, page_token: String::new() };
        every_page!(self.policies(), list_deployments, request, ListDeploymentsResponse { deployments })
    }

    /// Every evaluation of a policy, newest first, as one page.
    ///
    /// # Errors
    /// [`crate::ClientError::Rejected`] when there is no such policy.
    pub async fn every_evaluation(&self, policy_id: &str) -> Result<ListEvaluationsResponse> {
        let (policy_id, page_size) = (policy_id.to_owned(), PAGE_OF_LARGE_ROWS);
        let request = ListEvaluationsRequest { policy_id, page_size, page_token: String::new() };
        every_page!(self.policies(), list_evaluations, request, ListEvaluationsResponse { evaluations })
    }
}

#[cfg(test)]
mod tests;
