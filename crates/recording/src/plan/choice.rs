//! The choice of the mapping that fits a recording: one of the task, or the one of this crate's writer.
//!
//! Recorded sessions of a task are in this crate's dialect, whatever dialects the task's demonstrations come in, so
//! every task reads it.

use std::borrow::Cow;

use crate::error::RecordingError;
use crate::tracks::Tracks;
use crate::write::written_mapping;
use gleaner_core::{FindingCode, Report, Severity};
use gleaner_core::{Mapping, TaskSpec};

/// Most topics that an error lists, and most characters of each.
const TOPICS_SHOWN: usize = 24;
const NAME_SHOWN: usize = 80;
/// Likeness of two topics, from 0 to 1, from which one may be a slip for the other.
const NEAR: f64 = 0.6;

/// The task with one more mapping at the end, unless it has it: that of what [`crate::EpisodeWriter`] writes.
pub(crate) fn readable(spec: &TaskSpec) -> Cow<'_, TaskSpec> {
    let written = written_mapping(spec);
    if spec.mappings.contains(&written) {
        return Cow::Borrowed(spec);
    }
    let mut spec = spec.clone();
    spec.mappings.push(written);
    Cow::Owned(spec)
}

/// The mapping with the most topics among those whose topics all exist, one whose fields are all there before others. Only the first `own` are the task's: a later one
/// is chosen if it fits and none of those does, and no finding names it.
pub(crate) fn choose_mapping(
    tracks: &Tracks,
    spec: &TaskSpec,
    own: usize,
    report: &mut Report,
) -> Result<usize, RecordingError> {
    let fits = |at: usize| fits(tracks, spec, at);
    let score = |(at, mapping): &(usize, &Mapping)| {
        (missing(tracks, spec, mapping).len(), !fits(*at), usize::MAX - mapping.topics(spec).len())
    };
    let best = spec.mappings.iter().enumerate().take(own).min_by_key(score);
    if best.is_none_or(|(at, _)| !fits(at))
        && let Some((at, written)) = spec.mappings.iter().enumerate().skip(own).find(|(at, _)| fits(*at))
    {
        report.mapping.clone_from(&written.name);
        return Ok(at);
    }
    let Some((at, mapping)) = best else {
        let problem = "the task has no mapping; add one with the topics of its cameras and fields";
        return Err(RecordingError::Spec { field: "mappings".into(), problem: problem.into() });
    };
    report.mapping.clone_from(&mapping.name);
    let missing = missing(tracks, spec, mapping);
    if missing.is_empty() {
        return Ok(at);
    }
    for (number, topic) in missing.into_iter().enumerate() {
        let nearest = nearest(tracks, &topic).map(|near| format!(" (did you mean {near}?)")).unwrap_or_default();
        // Once, because the list is long.
        let there = if number == 0 { there(tracks) } else { String::new() };
        let detail = format!(
            "mapping `{}` is the nearest but its topic {topic} has no messages in the file{nearest}{there}; \
             correct the mapping, or add one for the topics that are there",
            mapping.name
        );
        report.add(Severity::Error, FindingCode::MissingTopic, &topic, None, detail);
    }
    Err(RecordingError::Rejected(Box::new(std::mem::take(report).sorted())))
}

/// The topics of the file that have messages, for an error.
fn there(tracks: &Tracks) -> String {
    let topics: Vec<&str> = with_messages(tracks).collect();
    let more = if topics.len() > TOPICS_SHOWN { ", …" } else { "" };
    let shown: Vec<String> = topics.into_iter().take(TOPICS_SHOWN).map(shortened).collect();
    if shown.is_empty() {
        "; no topic has any".to_owned()
    } else {
        format!("; those that have: {}{more}", shown.join(", "))
    }
}

/// The topic of the file whose name is nearest, if it is near.
fn nearest<'a>(tracks: &'a Tracks, topic: &str) -> Option<&'a str> {
    let near = |other: &str| strsim::normalized_damerau_levenshtein(other, topic);
    let short = with_messages(tracks).filter(|other| other.len() <= NAME_SHOWN);
    let nearest = short.map(|other| (near(other), other)).max_by(|one, other| one.0.total_cmp(&other.0))?;
    (nearest.0 >= NEAR).then_some(nearest.1)
}

fn with_messages(tracks: &Tracks) -> impl Iterator<Item = &str> {
    tracks.topics.iter().filter(|topic| topic.messages > 0).map(|topic| topic.topic.as_str())
}

fn shortened(topic: &str) -> String {
    let short: String = topic.chars().take(NAME_SHOWN).collect();
    if short.len() < topic.len() { short + "…" } else { short }
}

fn missing(tracks: &Tracks, spec: &TaskSpec, mapping: &Mapping) -> Vec<String> {
    let topics = mapping.topics(spec);
    topics.iter().filter(|&&topic| !tracks.tracks.contains_key(topic)).map(|&topic| topic.to_owned()).collect()
}

/// Whether all its topics are there, and carry all its fields.
fn fits(tracks: &Tracks, spec: &TaskSpec, at: usize) -> bool {
    let mapping = &spec.mappings[at];
    let carried = |source: usize, topic: &str| {
        tracks.tracks.get(topic).is_some_and(|track| {
            let mut fields = track.fields.iter().filter(|field| (field.mapping, field.source) == (at, source));
            track.failure.is_none() && fields.all(|field| !field.messages.is_empty() && field.failure.is_none())
        })
    };
    missing(tracks, spec, mapping).is_empty()
        && mapping.fields.iter().enumerate().all(|(source, field)| carried(source, &field.topic))
}
