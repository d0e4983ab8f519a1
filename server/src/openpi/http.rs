//! One connection until it is a WebSocket: its health check, its token, its deployment.
//!
//! Must not know the messages of a session.

use std::{convert::Infallible, sync::Arc};

use gleaner_edge::{Connection, ConnectionState, Transport};
use http::{
    HeaderMap, Method, Request, Response, StatusCode,
    header::{AUTHORIZATION, CONNECTION, CONTENT_TYPE, ORIGIN, SEC_WEBSOCKET_ACCEPT, SEC_WEBSOCKET_KEY, UPGRADE},
};
use hyper::{body::Incoming, server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{
        handshake::derive_accept_key,
        protocol::{Role, WebSocketConfig},
    },
};

use super::{
    Shared,
    keepalive::Counted,
    session::{self, Wanted},
};
use crate::{
    access::token_hash,
    error::{Error, Kind, Result},
    wire::policy::deployment_name,
};

/// Serves one connection: one request, which may become a WebSocket.
pub(super) async fn serve(connection: Connection<Transport>, shared: Arc<Shared>) {
    let state = connection.state().clone();
    let answer = service_fn(move |request: Request<Incoming>| {
        let (shared, state) = (Arc::clone(&shared), state.clone());
        async move { Ok::<_, Infallible>(respond(request, shared, state).await) }
    });
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .serve_connection(TokioIo::new(connection), answer)
        .with_upgrades()
        .await;
    if let Err(error) = served {
        tracing::debug!(%error, "a connection of openpi ended early");
    }
}

async fn respond(mut request: Request<Incoming>, shared: Arc<Shared>, state: ConnectionState) -> Response<String> {
    state.note_call();
    if request.method() == Method::GET && request.uri().path() == "/healthz" {
        return text(StatusCode::OK, "OK\n");
    }
    let Some(key) = websocket_key(request.headers()) else {
        return text(
            StatusCode::UPGRADE_REQUIRED,
            "connect with a WebSocket, such as openpi's WebsocketClientPolicy\n",
        );
    };
    if request.headers().contains_key(ORIGIN) {
        // Browsers alone send it: a page of another site would act for its visitor on this machine.
        return text(StatusCode::FORBIDDEN, "connections from web pages are refused; connect from a program\n");
    }
    let wanted = match wanted(&request, &shared, &state).await {
        Ok(wanted) => wanted,
        Err(error) => return text(status(error.kind()), error.message()),
    };
    let most = gleaner_openpi::largest_request(&wanted.task.spec).min(shared.services.config.limits.max_message_bytes);
    let upgraded = hyper::upgrade::on(&mut request);
    tokio::spawn(async move {
        match upgraded.await {
            Ok(io) => {
                let limits = WebSocketConfig::default().max_message_size(Some(most)).max_frame_size(Some(most));
                let stream = Counted::new(TokioIo::new(io));
                let socket = WebSocketStream::from_raw_socket(stream, Role::Server, Some(limits)).await;
                session::run(socket, wanted, &shared.services).await;
            }
            Err(error) => tracing::debug!(%error, "a connection of openpi was not upgraded"),
        }
    });
    let mut response = Response::new(String::new());
    *response.status_mut() = StatusCode::SWITCHING_PROTOCOLS;
    let headers = response.headers_mut();
    headers.insert(UPGRADE, http::HeaderValue::from_static("websocket"));
    headers.insert(CONNECTION, http::HeaderValue::from_static("Upgrade"));
    if let Ok(accept) = derive_accept_key(key.as_bytes()).parse() {
        headers.insert(SEC_WEBSOCKET_ACCEPT, accept);
    }
    response
}

/// The key of a WebSocket's handshake; `None` for any other request.
fn websocket_key(headers: &HeaderMap) -> Option<String> {
    let upgrade = headers.get(UPGRADE)?.to_str().ok()?;
    upgrade.eq_ignore_ascii_case("websocket").then_some(())?;
    headers.get(SEC_WEBSOCKET_KEY)?.to_str().ok().map(str::to_owned)
}

/// The deployment that the path names; the only one there is, where the path is empty.
async fn wanted(request: &Request<Incoming>, shared: &Shared, state: &ConnectionState) -> Result<Wanted> {
    let hash = token(request.headers()).map(token_hash);
    let (call, caller) = shared.guard.admit(hash.as_deref(), state).await?;
    let caller = caller?;
    caller.may_open_sessions()?;
    let store = &shared.services.store;
    let path = request.uri().path().trim_matches('/').replace("%40", "@");
    let deployment = if path.is_empty() {
        let mut all = store.deployments(None).await?;
        all.retain(|deployment| caller.sees(&deployment.name));
        match &all[..] {
            [only] => only.name.clone(),
            _ => {
                let names: Vec<&str> = all.iter().map(|deployment| deployment.name.as_str()).collect();
                let known = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
                let fix = format!("the path names none, such as ws://…/pick_cube@prod; existing: {known}");
                return Err(Error::not_found("deployment", fix));
            }
        }
    } else {
        deployment_name("deployment", path)?
    };
    caller.uses(&deployment)?;
    let task = store.task_by_id(&store.deployment(&deployment).await?.task_id).await?;
    Ok(Wanted { deployment, task, caller, _counted: call, peer: state.peer().to_string() })
}

/// The token: openpi's clients send it as an API key.
fn token(headers: &HeaderMap) -> Option<&str> {
    let (scheme, token) = headers.get(AUTHORIZATION)?.to_str().ok()?.split_once(' ')?;
    let known = scheme.eq_ignore_ascii_case("api-key") || scheme.eq_ignore_ascii_case("bearer");
    known.then(|| token.trim())
}

fn status(kind: Kind) -> StatusCode {
    match kind {
        Kind::Invalid | Kind::Precondition | Kind::Exists => StatusCode::BAD_REQUEST,
        Kind::NotFound => StatusCode::NOT_FOUND,
        Kind::Unauthenticated => StatusCode::UNAUTHORIZED,
        Kind::Forbidden => StatusCode::FORBIDDEN,
        Kind::Exhausted => StatusCode::TOO_MANY_REQUESTS,
        Kind::Unavailable | Kind::Late | Kind::Cancelled => StatusCode::SERVICE_UNAVAILABLE,
        Kind::Damaged | Kind::Internal => StatusCode::INTERNAL_SERVER_ERROR,
    }
}

fn text(status: StatusCode, text: &str) -> Response<String> {
    let mut response = Response::new(text.to_owned());
    *response.status_mut() = status;
    // A connection carries one request. Without keep-alive, hyper would also answer an upgrade with `close`, which strict
    // clients refuse.
    response.headers_mut().insert(CONNECTION, http::HeaderValue::from_static("close"));
    response.headers_mut().insert(CONTENT_TYPE, http::HeaderValue::from_static("text/plain; charset=utf-8"));
    response
}
