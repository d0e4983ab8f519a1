//! Signing in with a token, and signing out.

use axum::{
    Extension, Form,
    http::{
        StatusCode,
        header::{LOCATION, SET_COOKIE},
    },
    response::{IntoResponse as _, Response},
};
use maud::html;
use serde::Deserialize;

use super::{browser::Browser, page_request::PageRequest, refusal::Answer, shell};
use crate::{
    access::{Page, PageGuard, token_hash},
    config::Secret,
};

/// The page to continue with.
#[derive(Deserialize)]
struct Next {
    #[serde(default)]
    next: String,
}

/// A form with a token.
#[derive(Deserialize)]
pub(super) struct Shown {
    token: Unlogged,
    #[serde(default)]
    next: String,
}

/// A token, hidden from logs.
#[derive(Deserialize)]
#[serde(from = "String")]
struct Unlogged(Secret);

impl From<String> for Unlogged {
    fn from(text: String) -> Self {
        Self(Secret::from(text))
    }
}

pub(super) async fn form(request: PageRequest) -> Answer {
    let Next { next } = request.parameters()?;
    let body = html! {
        form.sign-in method="post" action="/sign-in" {
            h1 { "gleaner" }
            p { "Paste a token. The operator of this server issues tokens with " code { "gleaner-server token create" } "." }
            label for="token" { "Token" }
            input #token name="token" type="password" autocomplete="current-password" required autofocus;
            input type="hidden" name="next" value=(next);
            input type="hidden" name="proof" value=(request.proof);
            button.primary type="submit" { "Sign in" }
        }
    };
    Ok(shell::alone("Sign in", &body).into_response())
}

pub(super) async fn sign_in(
    request: PageRequest,
    Extension(browser): Extension<Browser>,
    Form(Shown { token, next }): Form<Shown>,
) -> Answer {
    let hash = token_hash(token.0.reveal().trim());
    let caller = request.state.guard.authenticate(&hash).await?;
    // A token that opens no page is not stored.
    PageGuard::permit(&caller, Page::Overview)?;
    request.state.signed_in.sign_out(&browser);
    let browser = request.state.signed_in.sign_in(hash);
    let cookie = browser.cookie(&request.state.cookie, request.state.encrypted);
    Ok((StatusCode::SEE_OTHER, [(LOCATION, local(&next).to_owned())], [(SET_COOKIE, cookie)]).into_response())
}

pub(super) async fn sign_out(request: PageRequest, Extension(browser): Extension<Browser>) -> Response {
    request.state.signed_in.sign_out(&browser);
    (StatusCode::SEE_OTHER, [(LOCATION, "/sign-in")]).into_response()
}

/// A local page to continue with. An address of another server, or one that could be read as such, is ignored.
fn local(next: &str) -> &str {
    let plain = next.bytes().all(|byte| byte.is_ascii_graphic() && byte != b'\\');
    if plain && next.starts_with('/') && !next.starts_with("//") { next } else { "/" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sign_in_never_redirects_to_another_server() {
        assert_eq!(local("/runs/1?beta=0.5"), "/runs/1?beta=0.5");
        for elsewhere in ["", "//evil.example", "https://evil.example", "/\\evil", "/a\r\nb", "javascript:1"] {
            assert_eq!(local(elsewhere), "/", "{elsewhere:?}");
        }
    }
}
