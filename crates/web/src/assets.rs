//! Styles and scripts, embedded in the program. Their addresses contain their digests, so that browsers cache them for
//! good.

use std::{collections::HashMap, sync::LazyLock};

use axum::{
    extract::Path,
    http::header::{CACHE_CONTROL, CONTENT_TYPE},
    response::IntoResponse as _,
};
use gleaner_core::Error;

use super::refusal::Answer;

const CSS: &str = "text/css; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";

/// Name, kind, content.
const ASSETS: &[(&str, &str, &str)] = &[
    ("gleaner.css", CSS, include_str!("assets/gleaner.css")),
    ("live.js", JS, include_str!("assets/live.js")),
    ("run.js", JS, include_str!("assets/run.js")),
    ("job.js", JS, include_str!("assets/job.js")),
    ("jobs.js", JS, include_str!("assets/jobs.js")),
    ("episodes.js", JS, concat!(include_str!("assets/labelling.js"), include_str!("assets/episodes.js"))),
    ("episode.js", JS, concat!(include_str!("assets/labelling.js"), include_str!("assets/episode.js"))),
    ("gleaner.svg", SVG, include_str!("assets/gleaner.svg")),
];

/// By the last part of its address.
static BY_ADDRESS: LazyLock<HashMap<String, (&str, &str)>> = LazyLock::new(|| {
    ASSETS.iter().map(|(name, kind, content)| (addressed(name, content), (*kind, *content))).collect()
});
/// Addresses by name.
static PATHS: LazyLock<HashMap<&str, String>> = LazyLock::new(|| {
    ASSETS.iter().map(|(name, _, content)| (*name, format!("/assets/{}", addressed(name, content)))).collect()
});

fn addressed(name: &str, content: &str) -> String {
    let digest = blake3::hash(content.as_bytes()).to_hex();
    format!("{}-{name}", digest.get(..12).unwrap_or_default())
}

/// The address of a style or script.
pub(super) fn path(name: &str) -> &'static str {
    PATHS.get(name).map_or("/assets/missing", String::as_str)
}

pub(super) async fn serve(Path(name): Path<String>) -> Answer {
    let (kind, content) = BY_ADDRESS.get(&name).ok_or_else(|| Error::not_found("asset", name.escape_debug()))?;
    Ok(([(CONTENT_TYPE, *kind), (CACHE_CONTROL, "public, max-age=31536000, immutable")], *content).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_asset_has_its_address_and_loads_no_foreign_resource() {
        for (name, _, content) in ASSETS {
            let address = path(name).strip_prefix("/assets/");
            assert_eq!(address.and_then(|address| BY_ADDRESS.get(address)).map(|found| found.1), Some(*content));
            let outside = content.replace("http://www.w3.org/", "");
            assert!(!outside.contains("://") && !outside.contains("@import"), "{name}");
        }
    }

    /// The luminance of a colour `#rrggbb` as defined by WCAG.
    fn luminance(colour: &str) -> f64 {
        let part = |at: usize| {
            let value = f64::from(u8::from_str_radix(&colour[at..at + 2], 16).unwrap()) / 255.0;
            if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
        };
        0.2126 * part(1) + 0.7152 * part(3) + 0.0722 * part(5)
    }

    /// Text needs a contrast of 4.5 to 1, lines and focus marks 3 to 1.
    #[test]
    fn colours_have_enough_contrast_in_light_and_dark() {
        let text = [
            ("ink", ["ground", "surface", "raised", "shade"].as_slice()),
            ("soft", &["ground", "surface", "raised"]),
            ("accent", &["ground", "surface", "raised", "shade"]),
            ("accent-ink", &["accent"]),
            ("good", &["surface", "good-wash"]),
            ("bad", &["surface", "bad-wash"]),
            ("other", &["surface", "other-wash"]),
        ];
        let marks = ["focus", "plot-1", "plot-2", "plot-3", "plot-4", "plot-5", "plot-6"];
        let style = include_str!("assets/gleaner.css");
        let themes: Vec<HashMap<&str, &str>> = style
            .split(":root {")
            .skip(1)
            .map(|theme| {
                let of_theme = theme.split('}').next().unwrap();
                of_theme.split(';').filter_map(|line| line.trim().strip_prefix("--")?.split_once(": ")).collect()
            })
            .collect();
        assert_eq!(themes.len(), 2);
        for theme in themes {
            let contrast = |a: &str, b: &str| {
                let (a, b) = (luminance(theme[a]), luminance(theme[b]));
                (a.max(b) + 0.05) / (a.min(b) + 0.05)
            };
            for (ink, grounds) in text {
                for ground in grounds {
                    assert!(contrast(ink, ground) >= 4.5, "{ink} on {ground}: {}", contrast(ink, ground));
                }
            }
            for mark in marks {
                assert!(contrast(mark, "surface") >= 3.0, "{mark}: {}", contrast(mark, "surface"));
            }
        }
    }
}
