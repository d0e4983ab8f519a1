//! Episodes, labels and reports on the wire.

use crate::{Finding, Report, Severity};
use gleaner_proto::v1;

use super::{field, page};
use crate::{
    episode::{Episode, EpisodeFilter, InspectedEpisode, Label, NewLabel, Outcome},
    error::{Error, Result},
    id::{EpisodeId, TaskId},
    page::Page,
};

/// Most episodes labelled or deleted in one call.
pub const MANY_EPISODES: usize = 10_000;

/// Reads an episode's id.
pub fn episode_id(text: &str) -> Result<EpisodeId> {
    EpisodeId::parse("episode_id", text)
}

/// Reads an outcome; `None` when unspecified.
pub fn outcome_from_proto(field: &str, outcome: i32) -> Result<Option<Outcome>> {
    match v1::Outcome::try_from(outcome) {
        Ok(v1::Outcome::Unspecified) => Ok(None),
        Ok(v1::Outcome::Success) => Ok(Some(Outcome::Success)),
        Ok(v1::Outcome::Failure) => Ok(Some(Outcome::Failure)),
        Ok(v1::Outcome::Unknown) => Ok(Some(Outcome::Unknown)),
        Err(_) => Err(Error::invalid(field, "unknown value; supported: success, failure, unknown")),
    }
}

/// Reads an outcome that must be set.
///
/// # Errors
/// Invalid when it is not set or not known.
pub fn required_outcome(outcome: i32) -> Result<Outcome> {
    outcome_from_proto("outcome", outcome)?
        .ok_or_else(|| Error::invalid("outcome", "must be set: success, failure or unknown"))
}

/// An outcome.
pub fn outcome_to_proto(outcome: Outcome) -> v1::Outcome {
    match outcome {
        Outcome::Success => v1::Outcome::Success,
        Outcome::Failure => v1::Outcome::Failure,
        Outcome::Unknown => v1::Outcome::Unknown,
    }
}

/// Filter and page of a list of episodes.
pub struct Listing {
    /// The filter of the episodes.
    pub filter: EpisodeFilter,
    /// The last episode of the page before; `None` for the first page.
    pub after: Option<EpisodeId>,
    /// The most episodes on a page.
    pub size: u32,
}

/// The filter and page of a list of episodes. A page token is the id of the last episode of the page before.
pub fn list_request(request: v1::ListEpisodesRequest, task_id: TaskId) -> Result<Listing> {
    let v1::ListEpisodesRequest { task: _, outcome, cohort, page_size, page_token, deleted } = request;
    let after = match page_token.as_str() {
        "" => None,
        token => Some(EpisodeId::parse("page_token", token).map_err(|_| field::foreign_page_token())?),
    };
    let cohort = (!cohort.is_empty()).then_some(cohort);
    let filter = EpisodeFilter { task_id, outcome: outcome_from_proto("outcome", outcome)?, cohort, deleted };
    Ok(Listing { filter, after, size: field::page_size(page_size)? })
}

/// The first part of a token of a page of labels, whose second is the number of a label.
const LABEL: &str = "label";

/// The episode, and the page of its labels.
///
/// # Errors
/// Invalid names the field.
pub fn labels_request(request: v1::ListLabelsRequest) -> Result<(EpisodeId, Page<i64>)> {
    let v1::ListLabelsRequest { episode_id: id, page_size, page_token } = request;
    let number = |token: &str| page::named_key(LABEL, token)?.parse().ok();
    Ok((episode_id(&id)?, page::page(page_size, &page_token, number)?))
}

/// The token of the page of labels behind a number; empty behind the last page.
pub fn labels_token(next: Option<i64>) -> String {
    page::token(next.map(|number| page::named_token(LABEL, number)))
}

/// The episodes to label, and their label, which has an outcome or a cohort.
pub fn label_request(request: v1::LabelEpisodesRequest) -> Result<(Vec<EpisodeId>, NewLabel)> {
    let v1::LabelEpisodesRequest { episode_ids, outcome, cohort, author, reason } = request;
    let ids = episode_ids_of(&episode_ids)?;
    let outcome = outcome_from_proto("outcome", outcome)?;
    if outcome.is_none() && cohort.is_none() {
        return Err(Error::invalid("outcome", "or cohort must be set; without an outcome each episode keeps its own"));
    }
    let label = NewLabel {
        outcome,
        cohort: cohort.map(|cohort| field::tag("cohort", cohort)).transpose()?,
        author: field::tag("author", author)?,
        reason: field::tag("reason", reason)?,
    };
    Ok((ids, label))
}

/// Episode ids; an empty list is rejected.
fn episode_ids_of(episode_ids: &[String]) -> Result<Vec<EpisodeId>> {
    if episode_ids.is_empty() || episode_ids.len() > MANY_EPISODES {
        return Err(Error::invalid("episode_ids", format!("name 1 to {MANY_EPISODES} episodes")));
    }
    let ids = episode_ids.iter().enumerate().map(|(i, id)| EpisodeId::parse(&format!("episode_ids[{i}]"), id));
    ids.collect()
}

/// The episodes to delete, and whether deletion is forced.
pub fn delete_request(request: &v1::DeleteEpisodesRequest) -> Result<(Vec<EpisodeId>, bool)> {
    Ok((episode_ids_of(&request.episode_ids)?, request.force))
}

/// The episodes to restore.
pub fn undelete_request(request: &v1::UndeleteEpisodesRequest) -> Result<Vec<EpisodeId>> {
    episode_ids_of(&request.episode_ids)
}

/// An episode.
pub fn episode(episode: Episode) -> v1::Episode {
    let Episode {
        id,
        task_id,
        file_name,
        recording,
        size_bytes,
        steps,
        duration_s,
        mapping,
        warnings,
        outcome,
        cohort,
        created_at,
        deleted_at,
    } = episode;
    v1::Episode {
        id: id.into(),
        task_id: task_id.into(),
        file_name,
        blake3: recording.into(),
        size_bytes,
        steps,
        duration_s,
        outcome: outcome_to_proto(outcome).into(),
        cohort,
        mapping,
        warnings: u32::try_from(warnings).unwrap_or(u32::MAX),
        create_time: Some(field::timestamp(created_at)),
        delete_time: deleted_at.map(field::timestamp),
    }
}

/// An episode with the report of its inspection.
pub fn inspected(inspected: InspectedEpisode) -> (v1::Episode, v1::Report) {
    let duration_s = inspected.episode.duration_s;
    (episode(inspected.episode), report(inspected.report, duration_s))
}

/// A report, with the duration in seconds.
pub fn report(report: Report, duration_s: f64) -> v1::Report {
    let Report { mapping, messages, steps, duration_ns: _, rate_hz, dropped_ticks: _, topics: _, findings } = report;
    v1::Report { findings: findings.into_iter().map(finding).collect(), mapping, messages, steps, duration_s, rate_hz }
}

fn finding(finding: Finding) -> v1::Finding {
    let Finding { severity, code, subject, first_step, detail } = finding;
    let severity = match severity {
        Severity::Note => v1::Severity::Note,
        Severity::Warning => v1::Severity::Warning,
        Severity::Error => v1::Severity::Error,
    };
    // The JSON word of the code, such as missing_topic.
    let code = serde_json::to_value(code).ok().and_then(|code| code.as_str().map(str::to_owned)).unwrap_or_default();
    v1::Finding { severity: severity.into(), code, subject, first_step, detail }
}

/// A label.
pub fn label(label: Label) -> v1::Label {
    let Label { outcome, cohort, author, reason, created_at } = label;
    v1::Label {
        outcome: outcome_to_proto(outcome).into(),
        cohort,
        author,
        reason,
        create_time: Some(field::timestamp(created_at)),
    }
}

#[cfg(test)]
mod tests {
    use crate::FindingCode;

    use super::*;

    #[test]
    fn a_malformed_page_token_is_rejected() {
        let request = |token: &str, page_size| v1::ListEpisodesRequest {
            page_token: token.into(),
            page_size,
            ..Default::default()
        };
        let after = EpisodeId::new();
        let listing = list_request(request(after.as_str(), 0), TaskId::new()).unwrap();
        assert_eq!((listing.after, listing.size), (Some(after), 100));
        for (token, size, field) in [("17", 5, "page_token: "), ("", 1001, "page_size: ")] {
            let error = list_request(request(token, size), TaskId::new()).err().unwrap();
            assert!(error.message().starts_with(field), "{error}");
        }
    }

    #[test]
    fn a_label_needs_episodes_and_an_outcome_or_a_cohort() {
        let id = EpisodeId::new();
        let request = |ids: &[&str], outcome: v1::Outcome| v1::LabelEpisodesRequest {
            episode_ids: ids.iter().map(|&id| id.to_owned()).collect(),
            outcome: outcome.into(),
            ..Default::default()
        };
        let (ids, label) = label_request(request(&[id.as_str()], v1::Outcome::Failure)).unwrap();
        assert_eq!((ids, label.outcome, label.cohort), (vec![id.clone()], Some(Outcome::Failure), None));
        let cohort = Some("night".to_owned());
        let kept =
            v1::LabelEpisodesRequest { cohort: cohort.clone(), ..request(&[id.as_str()], v1::Outcome::Unspecified) };
        let (_, label) = label_request(kept).unwrap();
        assert_eq!((label.outcome, label.cohort), (None, cohort));
        for (request, field) in [
            (request(&[], v1::Outcome::Failure), "episode_ids: "),
            (request(&[id.as_str(), "x"], v1::Outcome::Failure), "episode_ids[1]: "),
            (request(&[id.as_str()], v1::Outcome::Unspecified), "outcome: "),
        ] {
            let error = label_request(request).unwrap_err();
            assert!(error.message().starts_with(field), "{error}");
        }
    }

    #[test]
    fn a_finding_keeps_its_severity_and_code() {
        let found = finding(Finding {
            severity: Severity::Warning,
            code: FindingCode::MissingTopic,
            subject: "/joints".into(),
            first_step: Some(3),
            detail: "record it".into(),
        });
        assert_eq!((found.code.as_str(), found.first_step), ("missing_topic", Some(3)));
        assert_eq!(found.severity, i32::from(v1::Severity::Warning));
    }
}
