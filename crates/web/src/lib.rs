//! The curation pages for people, and the endpoints for monitoring, on an address of their own.
//!
//! Knows HTTP and HTML, and the server only as a [`Backend`]; must not know gRPC, SQL or tensors. Every page has an
//! access rule, and every handler the middleware.

mod artifacts;
mod assets;
mod audit_draft;
mod backend;
mod browser;
mod caller;
mod change;
mod dataset;
mod deployments;
mod episode;
mod episodes;
mod escape;
mod forgery;
mod frames;
mod http1;
mod jobs;
mod kinds;
mod link;
mod machines;
mod middleware;
mod overview;
mod page;
mod page_request;
mod paging;
mod plot;
mod refusal;
mod routes;
mod runs;
mod settings;
mod sheet;
mod shell;
mod sign_in;
mod standing;
mod text;

use std::{net::SocketAddr, sync::Arc};

use axum::{Router, body::Body, extract::ConnectInfo};
use gleaner_core::client::Client;
use gleaner_edge::{ConnectionState, Tls};
use http::{Request, Response};
use tokio::net::TcpListener;
use tower::ServiceExt as _;

use self::browser::{Browser, SignedIn};
pub use self::{
    backend::{Access, Artifacts, Backend, Deployments, Disk, Episodes, Jobs, Machine, RunSummary, Scores, Tasks},
    caller::Caller,
    page::{Page, Rule},
};

/// The limits on the pages' connections and on the requests of each client.
pub type Connections = gleaner_edge::Connections<Client>;

/// The state shared by all pages.
struct AppState {
    backend: Arc<dyn Backend>,
    connections: Connections,
    signed_in: SignedIn,
    /// Held while a deployment is rolled back, so that a second click sees the first one's change.
    rolling_back: tokio::sync::Mutex<()>,
    /// The name of the browsers' cookie.
    cookie: String,
    /// Whether the connection to the browser is encrypted.
    encrypted: bool,
    /// Whether the pages are reachable from this machine only.
    loopback: bool,
}

/// Every page; clones share the signed-in browsers.
#[derive(Clone)]
pub struct Site {
    connections: Connections,
    router: Router,
}

impl Site {
    /// The pages of a server at this address, which may be encrypted.
    pub fn new(backend: Arc<dyn Backend>, connections: Connections, address: SocketAddr, encrypted: bool) -> Self {
        let state = AppState {
            backend,
            connections: connections.clone(),
            signed_in: SignedIn::default(),
            rolling_back: tokio::sync::Mutex::default(),
            cookie: Browser::cookie_name(address.port()),
            encrypted,
            loopback: address.ip().is_loopback(),
        };
        Self { connections, router: routes::all(&Arc::new(state)) }
    }

    /// Serves browsers until the listener is closed. `tls` is required where the pages are encrypted.
    pub async fn serve(self, listener: TcpListener, tls: Option<Arc<Tls>>) {
        http1::serve(self, listener, tls).await;
    }

    /// The response to one request of a connection.
    pub async fn respond<B>(&self, mut request: Request<B>, connection: ConnectionState) -> Response<Body>
    where
        B: http_body::Body<Data = bytes::Bytes, Error: Into<axum::BoxError>> + Send + 'static,
    {
        request.extensions_mut().insert(ConnectInfo(connection));
        let Ok(response) = self.router.clone().oneshot(request.map(Body::new)).await;
        response
    }
}
