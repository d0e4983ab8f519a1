//! The running sessions of a deployment: camera images, the newest q, response times.

use axum::{
    extract::Path,
    http::header::{CACHE_CONTROL, CONTENT_TYPE},
    response::IntoResponse as _,
};
use gleaner_core::{
    id::SessionId,
    live::{LiveSession, SessionState},
    time::Millis,
};
use maud::{Markup, html};

use crate::{page_request::PageRequest, refusal::Answer, text};

/// Sessions shown; further ones are only counted.
const MOST: usize = 24;

/// The part of an open page that is refreshed.
pub(crate) async fn fragment(request: PageRequest, Path(name): Path<String>) -> Answer {
    request.backend().deployment(&name).await?;
    Ok(sessions(&request, &name).into_response())
}

/// The sessions of a deployment.
pub(super) fn sessions(request: &PageRequest, deployment: &str) -> Markup {
    let all = request.backend().live();
    let own: Vec<_> = all.iter().filter(|(session, _)| session.deployment == deployment).collect();
    html! {
        @if own.is_empty() {
            p.panel.empty { "No open sessions." }
        } @else {
            p.soft { (text::counted(own.len() as u64, "session")) " open"
                @if own.len() > MOST { ", the newest " (MOST) " are shown" } "." }
            div.cards { @for (session, now) in own.iter().take(MOST) { (card(session, now)) } }
        }
    }
}

fn card(session: &LiveSession, now: &SessionState) -> Markup {
    // The address changes with each observation, so that each image is loaded once.
    let stamp = now.seen_at.map_or(0, |at| at.0);
    let milliseconds = |part: f64| now.quantile_us(part).map_or("–".to_owned(), milliseconds);
    html! {
        section.card {
            div.row {
                @for camera in &now.cameras {
                    img.live alt=(format!("camera {}", camera.camera)) width="112" height="112"
                        src=(format!("/sessions/{}/frames/{}?at={stamp}", session.id, camera.camera));
                }
                @if now.cameras.is_empty() { span.soft { "No image yet." } }
            }
            dl.facts {
                dt { "Session" } dd.id { (session.id) }
                dt { "Since" } dd { (text::time(session.since)) " UTC" @if session.recorded { ", recorded" } }
                dt { "Last seen" } dd { (ago(now.seen_at)) }
                dt { "Answers" } dd { (text::count(now.answered)) }
                dt { "p50 / p99" } dd { (milliseconds(0.5)) " / " (milliseconds(0.99)) }
                dt { "q" } dd { (quality(now)) }
                dt { "Policy" } dd { a.id href=(format!("/policies/{}", session.policy_id)) { (session.policy_id) } }
            }
        }
    }
}

fn quality(now: &SessionState) -> Markup {
    html! {
        @match &now.score {
            Some(score) => {
                meter min="0" max="1" low="0.3" high="0.6" optimum="1" value=(score.q) {} " " (format!("{:.2}", score.q)) " "
                a href=(format!("/episodes/{}?step={}", score.match_episode, score.match_step)) { "expert" }
            }
            None => span.soft { "not scored" },
        }
    }
}

fn ago(at: Option<Millis>) -> String {
    at.map_or("never".to_owned(), |at| {
        let milliseconds = u32::try_from((Millis::now().0 - at.0).max(0)).unwrap_or(u32::MAX);
        format!("{} ago", text::seconds(f64::from(milliseconds) / 1000.0))
    })
}

#[expect(clippy::cast_precision_loss, reason = "for reading")]
fn milliseconds(microseconds: u64) -> String {
    format!("{:.1} ms", microseconds as f64 / 1000.0)
}

/// The last image of a session's camera.
pub(crate) async fn frame(request: PageRequest, Path((session, camera)): Path<(String, String)>) -> Answer {
    let id = SessionId::parse("session", &session)?;
    let (kind, bytes) = request.backend().live_frame(&id, &camera).await?;
    Ok(([(CONTENT_TYPE, kind), (CACHE_CONTROL, "private, max-age=60")], bytes).into_response())
}
