//! Lists are read to their last page, against in-process services whose pages are short.

use gleaner_proto::v1::snapshot_service_server::{SnapshotService, SnapshotServiceServer};
use gleaner_proto::v1::task_service_server::{TaskService, TaskServiceServer};
use gleaner_proto::v1::*;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Code, Request, Response, Status};

use super::*;

type Reply<T> = std::result::Result<Response<T>, Status>;

/// The rows of every list.
const ROWS: usize = 5;
/// The most rows of a page, whatever its request allows.
const SHORT: usize = 2;

#[derive(Clone)]
struct Fake;

fn unused<T>() -> Reply<T> {
    Err(Status::failed_precondition("this fake lists only"))
}

/// The rows of the page that follows a token, which is a number of rows, and the token of the next page.
fn page(token: &str) -> (std::ops::Range<usize>, String) {
    let first = if token.is_empty() { 0 } else { token.parse().unwrap() };
    let end = (first + SHORT).min(ROWS);
    (first..end, if end < ROWS { end.to_string() } else { String::new() })
}

#[tonic::async_trait]
impl TaskService for Fake {
    async fn list_tasks(&self, request: Request<ListTasksRequest>) -> Reply<ListTasksResponse> {
        let ListTasksRequest { page_size, page_token } = request.into_inner();
        assert_eq!(page_size, PAGE_OF_LARGE_ROWS);
        let (rows, next_page_token) = page(&page_token);
        let tasks = rows.map(|row| Task { id: row.to_string(), ..Task::default() }).collect();
        Ok(Response::new(ListTasksResponse { tasks, next_page_token }))
    }

    async fn create_task(&self, _: Request<CreateTaskRequest>) -> Reply<CreateTaskResponse> {
        unused()
    }

    async fn get_task(&self, _: Request<GetTaskRequest>) -> Reply<GetTaskResponse> {
        unused()
    }

    async fn update_task(&self, _: Request<UpdateTaskRequest>) -> Reply<UpdateTaskResponse> {
        unused()
    }

    async fn delete_task(&self, _: Request<DeleteTaskRequest>) -> Reply<DeleteTaskResponse> {
        unused()
    }
}

#[tonic::async_trait]
impl SnapshotService for Fake {
    async fn list_snapshots(&self, request: Request<ListSnapshotsRequest>) -> Reply<ListSnapshotsResponse> {
        let ListSnapshotsRequest { task, page_size, page_token } = request.into_inner();
        assert_eq!(page_size, PAGE);
        if task != "reach" {
            return Err(Status::not_found("no such task"));
        }
        let (rows, next_page_token) = page(&page_token);
        let snapshots = rows.map(|row| Snapshot { id: row.to_string(), ..Snapshot::default() }).collect();
        Ok(Response::new(ListSnapshotsResponse { snapshots, next_page_token }))
    }

    async fn create_snapshot(&self, _: Request<CreateSnapshotRequest>) -> Reply<CreateSnapshotResponse> {
        unused()
    }

    async fn get_snapshot(&self, _: Request<GetSnapshotRequest>) -> Reply<GetSnapshotResponse> {
        unused()
    }

    async fn list_snapshot_episodes(
        &self,
        _: Request<ListSnapshotEpisodesRequest>,
    ) -> Reply<ListSnapshotEpisodesResponse> {
        unused()
    }
}

#[tokio::test]
async fn a_list_is_read_to_its_last_page() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let services = tonic::transport::Server::builder()
        .add_service(TaskServiceServer::new(Fake))
        .add_service(SnapshotServiceServer::new(Fake));
    let serving = tokio::spawn(services.serve_with_incoming(TcpListenerStream::new(listener)));
    let client = Client::connect(&url, None).await.unwrap();

    let whole: Vec<String> = (0..ROWS).map(|row| row.to_string()).collect();
    let tasks = client.every_task().await.unwrap();
    assert_eq!(tasks.tasks.into_iter().map(|task| task.id).collect::<Vec<_>>(), whole);
    assert_eq!(tasks.next_page_token, "", "one page");
    let snapshots = client.every_snapshot("reach").await.unwrap().snapshots;
    assert_eq!(snapshots.into_iter().map(|snapshot| snapshot.id).collect::<Vec<_>>(), whole);
    assert_eq!(client.every_snapshot("absent").await.unwrap_err().code(), Some(Code::NotFound));
    serving.abort();
}
