//! The middleware of every page: authentication, authorisation, the audit of refused requests, and the security headers
//! of every response.

use std::{sync::Arc, time::Duration};

use axum::{
    body::Body,
    extract::{ConnectInfo, Request, State},
    http::{
        HeaderMap, HeaderValue, StatusCode,
        header::{
            AUTHORIZATION, CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, LOCATION, REFERRER_POLICY, SET_COOKIE,
            X_CONTENT_TYPE_OPTIONS,
        },
    },
    middleware::Next,
    response::{IntoResponse as _, Response},
};
use futures::StreamExt as _;
use gleaner_core::{Error, Result, error::Kind, printable};
use gleaner_edge::{Call, ConnectionState};

use super::{
    AppState, Caller,
    audit_draft::AuditDraft,
    browser::Browser,
    escape, forgery,
    page::Page,
    page_request::{PageRequest, escaped},
    refusal::{ErrorText, Refusal},
    shell,
};

/// The largest body of a page: labels of some ten thousand episodes.
const BODY_BYTES: usize = 1 << 20;
/// The largest body of an unauthenticated request.
const OPEN_BODY_BYTES: usize = 64 << 10;
/// The time limit of a request and its page. A stream after that is watched by the connection.
const WITHIN: Duration = Duration::from_secs(30);

/// No foreign resource, no inline script, and no frame around the page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
                      form-action 'self'; base-uri 'none'; frame-ancestors 'none'";

/// Authenticates and authorises a request, then serves its page.
pub(super) async fn pass(
    State((state, page)): State<(Arc<AppState>, Page)>,
    ConnectInfo(connection): ConnectInfo<ConnectionState>,
    request: Request,
    next: Next,
) -> Response {
    connection.note_call();
    let known = Browser::of(request.headers(), &state.cookie);
    let browser = known.clone().unwrap_or_else(Browser::new);
    let wants_data = wants_data(&request);
    let uri = request.uri().clone();
    let served = within(page, serve(&state, page, &connection, &browser, (request, next))).await;
    let mut response = match served {
        Ok(response) => response,
        Err(error) if error.kind() == Kind::Unauthenticated && page.method() == "GET" && !wants_data => {
            let back = uri.path_and_query().map_or("/", |back| back.as_str());
            (StatusCode::SEE_OTHER, [(LOCATION, format!("/sign-in?next={}", escaped(back)))]).into_response()
        }
        Err(error) => Refusal(error).into_response(),
    };
    if let Some(text) = response.extensions_mut().remove::<ErrorText>() {
        response = error_response(response.status(), &text, wants_data);
    } else if response.status().is_client_error() && is_plain_text(response.headers()) {
        // Errors of axum itself, such as a malformed form.
        let status = response.status();
        let body = axum::body::to_bytes(response.into_body(), BODY_BYTES).await.unwrap_or_default();
        response = error_response(status, &ErrorText(String::from_utf8_lossy(&body).into_owned()), wants_data);
    }
    // Requests for images and data need no cookie.
    let remembered = (known.is_none() && !wants_data && page != Page::Asset).then_some(browser);
    finish(&state, &mut response, remembered);
    response
}

/// The response of a page, within the time limit. A download has none here: before its first byte its recording may be
/// fetched from a bucket or copied with scores, and either has a limit of its own.
async fn within(page: Page, serving: impl Future<Output = Result<Response>>) -> Result<Response> {
    if page.is_download() {
        return serving.await;
    }
    let served = tokio::time::timeout(WITHIN, serving).await;
    served.unwrap_or_else(|_| Err(Error::late("the request timed out; check whether it took effect before you retry")))
}

async fn serve(
    state: &Arc<AppState>,
    page: Page,
    connection: &ConnectionState,
    browser: &Browser,
    (request, next): (Request, Next),
) -> Result<Response> {
    state.expects(request.headers())?;
    let bearer = bearer(request.headers()).map(|token| state.backend.token_hash(token));
    let (call, caller) = identify(state, page, connection, (browser, bearer.as_deref())).await?;
    let (changes, audit) = (page.changes(), AuditDraft::begin(page, &caller, connection));
    if let Err(error) = caller.permit(page) {
        if changes && caller.token_id().is_none_or(|token| state.backend.audits_rejection(token)) {
            audit.write(&*state.backend, StatusCode::FORBIDDEN).await;
        }
        return Err(error);
    }
    let page_request = PageRequest {
        state: Arc::clone(state),
        caller: caller.clone(),
        audit: audit.clone(),
        proof: browser.proof(),
        data: wants_data(&request),
        uri: request.uri().clone(),
    };
    let mut request = request;
    if page.method() == "POST" {
        let most = if page.is_open() { OPEN_BODY_BYTES } else { BODY_BYTES };
        // A request with a token in a header does not come from a browser on another site.
        request = forgery::checked(request, most, bearer.is_none().then_some(page_request.proof.as_str())).await?;
    }
    request.extensions_mut().insert(browser.clone());
    request.extensions_mut().insert(page_request);
    // Further requests of this client wait meanwhile, except behind downloads, which may take minutes to begin.
    let turn = if page.is_download() { None } else { call.turn().await };
    let response = if changes { run_to_end(state, audit, next.run(request)).await? } else { next.run(request).await };
    drop(turn);
    let response = escape::answer(response).await?;
    Ok(response.map(|body| {
        let body = match caller {
            // A download ends when its token expires or is revoked.
            Caller::Known { ended, .. } if page.is_download() => {
                Body::from_stream(body.into_data_stream().take_until(ended.cancelled_owned()))
            }
            Caller::Known { .. } | Caller::Anyone => body,
        };
        Body::new(state.connections.response(body, connection, call))
    }))
}

/// Counts a request and authenticates it: by the token in its header, or by the one its browser signed in with.
///
/// # Errors
/// Exhausted; Unauthenticated, except for public pages.
async fn identify(
    state: &AppState,
    page: Page,
    connection: &ConnectionState,
    (browser, bearer): (&Browser, Option<&str>),
) -> Result<(Call, Caller)> {
    let remembered = if bearer.is_none() { state.signed_in.token_of(browser) } else { None };
    let (call, mut caller) = state.backend.admit(bearer.or(remembered.as_deref()), connection).await?;
    if caller.is_err() && remembered.is_some() {
        // The browser's token is no longer valid: the browser is signed out.
        state.signed_in.sign_out(browser);
        caller = state.backend.authenticate(None).await;
    }
    match caller {
        Err(_) if page.is_open() => Ok((call, Caller::Anyone)),
        caller => Ok((call, caller?)),
    }
}

/// Runs a page that changes something to its end, even if its caller is gone. Its audit entry is written if the page
/// did not receive the request.
async fn run_to_end(
    state: &Arc<AppState>,
    audit: AuditDraft,
    page: impl Future<Output = Response> + Send + 'static,
) -> Result<Response> {
    let state = Arc::clone(state);
    let running = tokio::spawn(async move {
        let response = page.await;
        audit.write(&*state.backend, response.status()).await;
        response
    });
    running.await.map_err(|error| Error::internal("making a change", error))
}

/// The token in the header, for programs that read pages.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let (scheme, token) = headers.get(AUTHORIZATION)?.to_str().ok()?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

fn is_plain_text(headers: &HeaderMap) -> bool {
    headers.get(CONTENT_TYPE).is_some_and(|kind| kind.as_bytes().starts_with(b"text/plain"))
}

/// Whether a program rather than a person reads the response.
fn wants_data(request: &Request) -> bool {
    let query = request.uri().query().unwrap_or_default();
    let accepts = request.headers().get("accept").and_then(|value| value.to_str().ok()).unwrap_or_default();
    query.split('&').any(|pair| pair.starts_with("format=")) || !accepts.contains("text/html")
}

fn error_response(status: StatusCode, text: &ErrorText, data: bool) -> Response {
    let message = printable::field(&text.0);
    if data {
        return (status, axum::Json(serde_json::json!({ "error": message }))).into_response();
    }
    (status, shell::bare(status.canonical_reason().unwrap_or("Refused"), &message)).into_response()
}

/// The response to an unknown address.
pub(super) async fn not_found(state: Arc<AppState>, connection: ConnectionState, request: Request) -> Response {
    connection.note_call();
    let text = ErrorText("Page not found. Check the address; copy ids from the lists.".to_owned());
    let mut response = error_response(StatusCode::NOT_FOUND, &text, wants_data(&request));
    finish(&state, &mut response, None);
    response
}

/// Sets the headers of every response.
fn finish(state: &AppState, response: &mut Response, new: Option<Browser>) {
    let headers = response.headers_mut();
    headers.insert(CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("same-origin"));
    headers.entry(CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    if let Some(browser) = new {
        headers.entry(SET_COOKIE).or_insert(browser.cookie(&state.cookie, state.encrypted));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn pages_have_a_time_limit_and_downloads_have_none() {
        for &page in Page::ALL {
            let slow = async {
                tokio::time::sleep(2 * WITHIN).await;
                Ok(StatusCode::OK.into_response())
            };
            match within(page, slow).await {
                Ok(_) => assert!(page.is_download(), "{page:?}"),
                Err(error) => assert!(error.kind() == Kind::Late && !page.is_download(), "{page:?}: {error}"),
            }
        }
    }
}
