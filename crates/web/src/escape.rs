//! Escaping of text in responses: control and bidirectional characters from recordings and callers never reach a
//! browser or a terminal raw.
//!
//! It is applied once, to the finished response, so that no page can omit it. Readers see escapes; JSON, and values
//! that a form or a script sends back, keep the text unchanged.

use std::fmt::Write as _;

use axum::{
    body::{Body, to_bytes},
    http::header::{CONTENT_LENGTH, CONTENT_TYPE},
    response::Response,
};
use gleaner_core::{
    Error, Result,
    printable::{Escape, is_printable},
};

/// The response with escaped text; images, recordings and our own scripts pass unchanged.
///
/// # Errors
/// Internal when the body fails.
pub(super) async fn answer(response: Response) -> Result<Response> {
    let kind = response.headers().get(CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
    let kind = kind.split(';').next().unwrap_or_default();
    let escape = match kind {
        "text/html" => html,
        "text/plain" | "text/csv" => |text: &str| Escape::Lines.apply(text).into_owned(),
        "application/json" => |text: &str| Escape::Json.apply(text).into_owned(),
        _ => return Ok(response),
    };
    let (mut parts, body) = response.into_parts();
    let bytes = to_bytes(body, usize::MAX).await.map_err(|error| Error::internal("making an answer", error))?;
    let escaped = match std::str::from_utf8(&bytes) {
        Ok(text) if text.chars().all(kept) => Body::from(bytes),
        Ok(text) => Body::from(escape(text)),
        Err(_) => Body::from(escape(&String::from_utf8_lossy(&bytes))),
    };
    parts.headers.remove(CONTENT_LENGTH);
    Ok(Response::from_parts(parts, escaped))
}

fn kept(character: char) -> bool {
    is_printable(character) || matches!(character, '\n' | '\t')
}

/// The context of a character in a page's markup. The markup is our own templates': quotes and angle brackets in text
/// are escaped, so that these characters are always markup.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Context {
    Text,
    Tag,
    /// A displayed attribute, such as a title.
    Shown,
    /// An attribute that is sent back or followed, such as a value or an address.
    Kept,
    /// JSON for a script.
    Script,
}

fn html(markup: &str) -> String {
    let mut out = String::with_capacity(markup.len() + 16);
    let (mut context, mut tag) = (Context::Text, 0);
    for (at, character) in markup.char_indices() {
        if !kept(character) {
            write(character, context, &mut out);
            continue;
        }
        out.push(character);
        context = match (context, character) {
            (Context::Text, '<') => {
                tag = at;
                Context::Tag
            }
            (Context::Script, '<') if markup[at..].starts_with("</script") => {
                tag = at;
                Context::Tag
            }
            (Context::Tag, '>') if markup[tag..].starts_with("<script") => Context::Script,
            (Context::Tag, '>') => Context::Text,
            (Context::Tag, '"') => attribute(&markup[tag..at]),
            (Context::Shown | Context::Kept, '"') => Context::Tag,
            (context, _) => context,
        };
    }
    out
}

/// The context of the attribute at the end of an open tag.
fn attribute(tag: &str) -> Context {
    let name = tag.trim_end_matches('=').rsplit(' ').next().unwrap_or_default();
    if matches!(name, "title" | "alt" | "placeholder" | "label") || name.starts_with("aria-") {
        Context::Shown
    } else {
        Context::Kept
    }
}

fn write(character: char, context: Context, out: &mut String) {
    let mut buffer = [0; 4];
    let text: &str = character.encode_utf8(&mut buffer);
    match context {
        Context::Text | Context::Shown => out.push_str(&Escape::Field.apply(text)),
        Context::Script => out.push_str(&Escape::Json.apply(text)),
        // Writing to a string cannot fail.
        Context::Tag | Context::Kept => {
            let _ = write!(out, "&#x{:x};", u32::from(character));
        }
    }
}

#[cfg(test)]
mod tests {
    use axum::response::IntoResponse as _;
    use maud::html;
    use serde_json::json;

    use super::*;
    use crate::shell;

    const HOSTILE: &str = "\u{1b}[2J\u{202e}<b>\"x";

    async fn answered(response: Response) -> String {
        let answer = answer(response).await.unwrap();
        String::from_utf8(to_bytes(answer.into_body(), usize::MAX).await.unwrap().to_vec()).unwrap()
    }

    #[tokio::test]
    async fn text_and_titles_show_escapes_and_values_are_unchanged() {
        let page = html! {
            p title=(HOSTILE) aria-label=(HOSTILE) { (HOSTILE) " a > b" }
            input value=(HOSTILE) data-cohort=(HOSTILE);
            (shell::data("about", &json!({ "cohort": HOSTILE })))
            p { "\u{200b}" }
        };
        let (shown, kept) = ("\\u{1b}[2J\\u{202e}&lt;b&gt;&quot;x", "&#x1b;[2J&#x202e;&lt;b&gt;&quot;x");
        assert_eq!(
            answered(page.into_response()).await,
            format!(
                "<p title=\"{shown}\" aria-label=\"{shown}\">{shown} a &gt; b</p>\
                 <input value=\"{kept}\" data-cohort=\"{kept}\">\
                 <script type=\"application/json\" id=\"about\">{{\"cohort\":\"\\u001b[2J\\u202e\\u003cb>\\\"x\"}}</script>\
                 <p>\\u{{200b}}</p>"
            )
        );
    }

    #[tokio::test]
    async fn json_keeps_its_text_and_plain_text_shows_escapes() {
        let data = answered(axum::Json(json!({ "name": HOSTILE })).into_response()).await;
        assert!(data.chars().all(is_printable), "{data}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&data).unwrap()["name"], HOSTILE);
        assert_eq!(answered("a\n\u{202e}\u{7}".into_response()).await, "a\n\\u{202e}\\u{7}");
        let picture = ([(CONTENT_TYPE, "image/png")], b"\x89PNG\x1b".to_vec()).into_response();
        let passed = to_bytes(answer(picture).await.unwrap().into_body(), usize::MAX).await.unwrap();
        assert_eq!(&passed[..], b"\x89PNG\x1b");
    }
}
