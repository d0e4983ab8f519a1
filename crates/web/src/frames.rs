//! Single steps of a recording as images.

use axum::{
    extract::Path,
    http::header::{CACHE_CONTROL, CONTENT_TYPE},
    response::IntoResponse as _,
};
use gleaner_core::{Error, id::EpisodeId, steps::FrameView};
use serde::Deserialize;

use super::{
    page_request::{PageRequest, escaped},
    refusal::Answer,
};

/// Pixels of a thumbnail: twice its displayed size.
pub(super) const THUMBNAIL: u32 = 160;

#[derive(Deserialize)]
struct Parameters {
    #[serde(default)]
    depth: bool,
    size: Option<u32>,
}

/// The address of a step's image, scaled down to this width and height.
pub(super) fn at(episode: &EpisodeId, camera: &str, step: u64, size: u32) -> String {
    format!("{}{step}?size={size}", before_step(episode, camera))
}

/// The address of a camera's images, up to the step.
pub(super) fn before_step(episode: &EpisodeId, camera: &str) -> String {
    format!("/episodes/{episode}/frames/{}/", escaped(camera))
}

/// Recordings are immutable, and so are their images.
pub(super) async fn show(request: PageRequest, Path((id, camera, step)): Path<(String, String, String)>) -> Answer {
    let Parameters { depth, size } = request.parameters()?;
    let id = EpisodeId::parse("episode", &id)?;
    let step = step.parse().map_err(|_| Error::invalid("step", "must be a whole number, counted from 0"))?;
    let jpeg = request.backend().frame(&id, FrameView { step, camera, depth, size }).await?;
    let headers = [(CONTENT_TYPE, "image/jpeg"), (CACHE_CONTROL, "private, max-age=31536000, immutable")];
    Ok((headers, jpeg).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_name_is_escaped_in_the_address() {
        let id = EpisodeId::parse("id", "ep_01ARZ3NDEKTSV4RRFFQ69G5FAV").unwrap();
        assert_eq!(
            at(&id, "../a b?c", 7, 160),
            "/episodes/ep_01ARZ3NDEKTSV4RRFFQ69G5FAV/frames/..%2Fa%20b%3Fc/7?size=160"
        );
    }
}
