//! Signing in with a token, and signing out.

use axum::{
    Extension, Form,
    http::{
        StatusCode,
        header::{LOCATION, SET_COOKIE},
    },
    response::{IntoResponse as _, Response},
};
use gleaner_core::{Error, Result, error::Kind};
use maud::{Markup, html};
use serde::Deserialize;

use super::{
    browser::Browser,
    page::Page,
    page_request::PageRequest,
    refusal::{Answer, status},
    shell,
};

/// The page to continue with.
#[derive(Deserialize)]
struct Next {
    #[serde(default)]
    next: String,
}

/// A form with a token. Must not implement Debug: tokens are not logged.
#[derive(Deserialize)]
pub(super) struct Shown {
    token: String,
    #[serde(default)]
    next: String,
}

pub(super) async fn form(request: PageRequest) -> Answer {
    let Next { next } = request.parameters()?;
    Ok(form_page(&request, &next, None).into_response())
}

/// The form; after a refused token, with the reason.
fn form_page(request: &PageRequest, next: &str, refused: Option<&Error>) -> Markup {
    let body = html! {
        form.sign-in method="post" action="/sign-in" {
            h1 { "gleaner" }
            @if let Some(error) = refused { p.note.bad role="alert" { (error.message()) } }
            p { "Paste a token. The operator of this server issues tokens with " code { "gleaner-server token create" } "." }
            label for="token" { "Token" }
            input #token name="token" type="password" autocomplete="current-password" required autofocus;
            input type="hidden" name="next" value=(local(next));
            input type="hidden" name="proof" value=(request.proof);
            button.primary type="submit" { "Sign in" }
        }
    };
    shell::alone("Sign in", &body)
}

pub(super) async fn sign_in(
    request: PageRequest,
    Extension(browser): Extension<Browser>,
    Form(Shown { token, next }): Form<Shown>,
) -> Answer {
    let hash = request.backend().token_hash(token.trim());
    match accept(&request, &hash).await {
        Ok(()) => {}
        // A person retries in the form, which keeps the page to continue with; a program gets the error.
        Err(error) if !request.data && matches!(error.kind(), Kind::Unauthenticated | Kind::Forbidden) => {
            return Ok((status(error.kind()), form_page(&request, &next, Some(&error))).into_response());
        }
        Err(error) => return Err(error.into()),
    }
    request.state.signed_in.sign_out(&browser);
    let browser = request.state.signed_in.sign_in(hash);
    let cookie = browser.cookie(&request.state.cookie, request.state.encrypted);
    Ok((StatusCode::SEE_OTHER, [(LOCATION, local(&next).to_owned())], [(SET_COOKIE, cookie)]).into_response())
}

/// Checks a token. One that opens no page is not stored.
async fn accept(request: &PageRequest, hash: &str) -> Result<()> {
    request.backend().authenticate(Some(hash)).await?.permit(Page::Overview)
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
