//! MCAP: the original messages of each piece with its scores beside them, and a manifest.

mod manifest;

use std::collections::BTreeMap;

use gleaner_core::snapshot::Role;
use gleaner_recording::{Kept, StepScore};

use crate::export::Export;
use crate::piece::Piece;
use crate::problem::Problem;
use manifest::{Line, Manifest, Step};

/// Writes a file for each piece, and the manifest.
pub(crate) fn write<E: Export>(export: &mut E) -> Result<(), E::Error> {
    let mut manifest = Manifest::create(export)?;
    for at in 0..export.pieces().len() {
        let piece = export.pieces()[at].clone();
        let (name, scores) = (format!("{}.mcap", piece.name()), piece.scores());
        match piece.role() {
            Role::Expert => export.finished_recording(at, &name)?,
            Role::Imperfect => {
                let kept =
                    Kept { first_step: count(piece.steps.start), scores: scores.clone(), about: about(export, &piece) };
                let out = export.folder().join(&name);
                gleaner_recording::extract(export.recording(at)?.as_ref(), export.task(), &kept, &out)
                    .map_err(Problem::recording(piece.episode().id.as_str()))?;
                export.finished(&name)?;
            }
        }
        manifest.push(&line(&piece, &name, &scores, export.segment_length()))?;
        export.advance()?;
    }
    manifest.finish(export)
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

fn count(length: usize) -> u64 {
    u64::try_from(length).unwrap_or(u64::MAX)
}
