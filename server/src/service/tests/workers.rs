//! Limits on the calls of workers' listener.

use futures::future::join_all;
use gleaner_edge::ConnectionState;
use gleaner_proto::Rpc;
use http::{Request, Response, header::AUTHORIZATION};
use tonic::{Code, Status, body::Body};
use tower::{Layer as _, Service as _, service_fn};

use super::{ID, Infallible, Server};
use crate::{access::Guard, config::ConnectionsConfig, connections::connections};

#[tokio::test]
async fn calls_of_workers_are_counted_for_their_address_before_the_disk_is_read() {
    let server = Server::start().await;
    let limits = connections(&ConnectionsConfig { calls_per_second: 1, ..ConnectionsConfig::default() });
    let guard = Guard::of_workers(server.services.jobs.clone(), limits);
    let call = async |machine: u8| {
        let service = service_fn(|_: Request<Body>| async { Ok::<_, Infallible>(Response::new(Body::empty())) });
        let mut request = Request::post(Rpc::WorkerServiceGetAssignment.path()).body(Body::empty()).unwrap();
        request.headers_mut().insert(AUTHORIZATION, format!("Bearer job_{ID}.00").parse().unwrap());
        request.extensions_mut().insert(ConnectionState::new(([10, 0, 0, machine], 7).into()));
        let response = guard.layer(service).call(request).await.unwrap();
        Code::from_bytes(response.headers()[Status::GRPC_STATUS].as_bytes())
    };
    // A burst has twice as many as a second.
    let codes = join_all((0..8).map(|_| call(1))).await;
    let of = |code| codes.iter().filter(|found| **found == code).count();
    assert!(of(Code::Unauthenticated) >= 2 && of(Code::ResourceExhausted) >= 4, "{codes:?}");
    assert_eq!(of(Code::Unauthenticated) + of(Code::ResourceExhausted), 8, "{codes:?}");
    assert_eq!(call(2).await, Code::Unauthenticated, "another machine has a rate of its own");
}
