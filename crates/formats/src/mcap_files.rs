//! MCAP: the original messages of each piece with its scores beside them, and a manifest.

use std::collections::BTreeMap;
use std::io::Write as _;

use gleaner_core::snapshot::Role;
use gleaner_recording::{Kept, StepScore};
use serde::Serialize;

use crate::export::Export;
use crate::piece::Piece;
use crate::problem::Problem;

/// The file that describes every other file, one line each.
const MANIFEST: &str = "manifest.jsonl";

/// One line of the manifest. Step numbers are those of the original episode.
#[derive(Serialize)]
struct Line<'a> {
    episode: &'a str,
    source: &'a str,
    file: &'a str,
    role: Role,
    first_step: u64,
    last_step: u64,
    /// l: the segment that ends at a step begins l steps before it.
    segment_length: u32,
    /// The kept steps; empty for experts, whose steps all have weight 1.
    steps: Vec<Step<'a>>,
}

/// One kept step: the end of a kept segment.
#[derive(Serialize)]
struct Step<'a> {
    step: u64,
    q: f32,
    w: f64,
    /// `None` when the scorer has no matches.
    nearest_episode: Option<&'a str>,
    nearest_step: Option<u32>,
}

/// Writes a file for each piece, and the manifest.
pub(crate) fn write<E: Export>(export: &mut E) -> Result<(), E::Error> {
    let mut manifest = Vec::new();
    for at in 0..export.pieces().len() {
        let piece = export.pieces()[at].clone();
        let (name, scores) = (format!("{}.mcap", piece.name()), piece.scores());
        match piece.role() {
            Role::Expert => export.finished_recording(at, &name)?,
            Role::Imperfect => {
                let kept =
                    Kept { first_step: count(piece.steps.start), scores: scores.clone(), about: about(export, &piece) };
                let out = export.folder().join(&name);
                gleaner_recording::extract(&export.recording(at), export.task(), &kept, &out)
                    .map_err(Problem::recording(piece.episode().id.as_str()))?;
                export.finished(&name)?;
            }
        }
        append(&mut manifest, &line(&piece, &name, &scores, export.segment_length()))
            .map_err(Problem::io(MANIFEST.as_ref()))?;
        export.advance()?;
    }
    let path = export.folder().join(MANIFEST);
    std::fs::write(&path, &manifest).map_err(Problem::io(&path))?;
    export.finished(MANIFEST)
}

/// The metadata of a stretch.
fn about<E: Export>(export: &E, piece: &Piece) -> BTreeMap<String, String> {
    let episode = piece.episode();
    let own = [
        ("episode", episode.id.as_str()),
        ("episode_source", &episode.file_name),
        ("outcome", episode.outcome.as_str()),
        ("cohort", &episode.cohort),
    ];
    let own = own.into_iter().map(|(name, value)| (name.to_owned(), value.to_owned()));
    export.origin().clone().into_iter().chain(own).collect()
}

fn line<'a>(piece: &'a Piece, file: &'a str, scores: &'a [StepScore], segment_length: u32) -> Line<'a> {
    let step = |(step, score): (usize, &'a StepScore)| Step {
        step: count(step),
        q: score.q,
        w: score.w,
        nearest_episode: score.matched.as_ref().map(|(episode, _)| episode.as_str()),
        nearest_step: score.matched.as_ref().map(|(_, step)| *step),
    };
    let steps = match piece.role() {
        Role::Expert => Vec::new(),
        Role::Imperfect => piece.steps.clone().zip(scores).filter(|(_, score)| score.kept).map(step).collect(),
    };
    Line {
        episode: piece.episode().id.as_str(),
        source: &piece.episode().file_name,
        file,
        role: piece.role(),
        first_step: count(piece.steps.start),
        last_step: count(piece.steps.end.saturating_sub(1)),
        segment_length,
        steps,
    }
}

fn append(manifest: &mut Vec<u8>, line: &Line<'_>) -> std::io::Result<()> {
    serde_json::to_writer(&mut *manifest, line)?;
    manifest.write_all(b"\n")
}

fn count(length: usize) -> u64 {
    u64::try_from(length).unwrap_or(u64::MAX)
}
