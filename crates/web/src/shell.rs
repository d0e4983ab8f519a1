//! The frame of every page: its head, the navigation and the signed-in caller.

use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::Value;

use super::{Caller, assets, link, page::Page, page_request::PageRequest};

/// The tab of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tab {
    /// Every task.
    Overview,
    /// A task's episodes.
    Episodes,
    /// A task's score runs and the results made from them.
    Runs,
    /// Jobs of all tasks.
    Jobs,
    /// All deployments.
    Deployments,
    /// Kinds and their settings.
    Kinds,
}

/// The head of a page.
pub(super) struct Head<'a> {
    pub(super) title: &'a str,
    pub(super) tab: Tab,
    /// The page's task, by name.
    pub(super) task: Option<&'a str>,
    /// Its script, if it has one.
    pub(super) script: Option<&'static str>,
}

/// A page with its frame.
pub(super) fn page(request: &PageRequest, head: &Head, body: &Markup) -> Markup {
    let link = |tab: Tab, to: &str, name: &str| {
        html! { a href=(to) aria-current=[(head.tab == tab).then_some("page")] { (name) } }
    };
    let top = html! {
        a.skip href="#main" { "Skip to content" }
        header.top {
            a.brand href="/" { img src=(assets::path("gleaner.svg")) alt=""; "gleaner" }
            nav aria-label="Pages" {
                (link(Tab::Overview, "/", "Overview"))
                @if let Some(task) = head.task {
                    span.task { (task) }
                    (link(Tab::Episodes, &format!("/tasks/{task}/episodes"), "Episodes"))
                    (link(Tab::Runs, &format!("/tasks/{task}/runs"), "Score runs"))
                }
                (link(Tab::Jobs, "/jobs", "Jobs"))
                (link(Tab::Deployments, "/deployments", "Deployments"))
                (link(Tab::Kinds, "/kinds", "Kinds"))
            }
            div.account { (signed_in(request)) }
        }
        main #main { (body) }
    };
    whole(head.title, Some(&request.proof), head.script, &top)
}

/// A page without navigation, before the sign-in.
pub(super) fn alone(title: &str, body: &Markup) -> Markup {
    whole(title, None, None, &html! { main { (body) } })
}

/// A page with a message only.
pub(super) fn bare(title: &str, message: &str) -> Markup {
    let body = html! {
        main {
            div.bare.panel role="alert" {
                h1 { (title) }
                p { (link::text(message)) }
                p { a href="/" { "Overview" } }
            }
        }
    };
    whole(title, None, None, &body)
}

/// Data for a page's script, by the id of its element.
pub(super) fn data(id: &str, value: &Value) -> Markup {
    // JSON escapes suffice: markup is not parsed there, except for the end of the element.
    let text = value.to_string().replace('<', "\\u003c");
    html! { script type="application/json" id=(id) { (PreEscaped(text)) } }
}

fn signed_in(request: &PageRequest) -> Markup {
    match &request.caller {
        Caller::Known { .. } => html! {
            span { (request.caller.name()) }
            form method="post" action=(Page::SigningOut.path()) {
                input type="hidden" name="proof" value=(request.proof);
                button.plain type="submit" { "Sign out" }
            }
        },
        Caller::Anyone => html! {},
    }
}

fn whole(title: &str, proof: Option<&str>, script: Option<&str>, body: &Markup) -> Markup {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                @if let Some(proof) = proof { meta name="proof" content=(proof); }
                title { (title) " · gleaner" }
                link rel="icon" type="image/svg+xml" href=(assets::path("gleaner.svg"));
                link rel="stylesheet" href=(assets::path("gleaner.css"));
                @if let Some(script) = script { script src=(assets::path(script)) defer {} }
            }
            body { (body) }
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn data_for_a_script_cannot_end_its_element() {
        let markup = data("x", &json!({ "name": "</script><b>&\"" })).into_string();
        assert_eq!(markup, r#"<script type="application/json" id="x">{"name":"\u003c/script>\u003cb>&\""}</script>"#);
    }
}
