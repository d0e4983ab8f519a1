//! The pages' listener: HTTP/1 over connections with the limits and the encryption of the gRPC listener. Each
//! connection carries one request, so that no idle connection is left open.

use std::{convert::Infallible, sync::Arc};

use axum::{Router, body::Body, extract::ConnectInfo};
use futures::StreamExt as _;
use gleaner_edge::{Connection, Protocol, Tls, Transport};
use http::{Request, Response};
use hyper::{body::Incoming, server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::TcpListener;
use tower::ServiceExt as _;

use crate::connections::Connections;

/// Serves pages until the listener is closed.
pub(super) async fn serve(connections: Connections, listener: TcpListener, tls: Option<Arc<Tls>>, pages: Router) {
    let mut incoming = connections.accept(listener, tls, Protocol::Http1);
    while let Some(Ok(connection)) = incoming.next().await {
        tokio::spawn(one(connection, pages.clone()));
    }
}

/// Serves one request.
async fn one(connection: Connection<Transport>, pages: Router) {
    let state = connection.state().clone();
    let answer = service_fn(move |mut request: Request<Incoming>| {
        request.extensions_mut().insert(ConnectInfo(state.clone()));
        let pages = pages.clone();
        async move { answered(pages, request.map(Body::new)).await }
    });
    let served = http1::Builder::new()
        .keep_alive(false)
        .timer(TokioTimer::new())
        .serve_connection(TokioIo::new(connection), answer)
        .await;
    if let Err(error) = served {
        tracing::debug!(%error, "a page's connection ended early");
    }
}

async fn answered(pages: Router, request: Request<Body>) -> Result<Response<Body>, Infallible> {
    pages.oneshot(request).await
}
