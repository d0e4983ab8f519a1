//! The pages' listener: HTTP/1 over connections with the limits and the encryption of the gRPC listener. Each
//! connection carries one request, so that no idle connection is left open.

use std::{convert::Infallible, sync::Arc};

use futures::StreamExt as _;
use gleaner_edge::{Connection, Protocol, Tls, Transport};
use http::Request;
use hyper::{body::Incoming, server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::TcpListener;

use super::Site;

/// Serves pages until the listener is closed.
pub(super) async fn serve(site: Site, listener: TcpListener, tls: Option<Arc<Tls>>) {
    let mut incoming = site.connections.accept(listener, tls, Protocol::Http1);
    while let Some(Ok(connection)) = incoming.next().await {
        tokio::spawn(one(connection, site.clone()));
    }
}

/// Serves one request.
async fn one(connection: Connection<Transport>, site: Site) {
    let state = connection.state().clone();
    let answer = service_fn(move |request: Request<Incoming>| {
        let (site, state) = (site.clone(), state.clone());
        async move { Ok::<_, Infallible>(site.respond(request, state).await) }
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
