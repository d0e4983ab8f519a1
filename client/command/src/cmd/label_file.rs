//! `label --from`: a labels.csv applied to episodes that are stored. Must not send recordings.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use gleaner_client::{Client, LabelledFile, read_labels};
use gleaner_proto::v1::{Episode, LabelEpisodesRequest, ListEpisodesRequest};

use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::ids::{every_page, stem};
use crate::words;

/// Labels the episodes that the file names, and leaves those that have their label already; returns the changed ones.
///
/// # Errors
/// A row without an episode, or with several; then no label is changed.
pub(super) async fn label(
    context: &Context,
    client: &Client,
    (file, task, reason): (&Path, Option<&str>, &str),
) -> Result<Vec<Episode>> {
    let rows = read_labels(file)?;
    let request = ListEpisodesRequest {
        task: context.task(client, task).await?,
        page_size: 1000,
        ..ListEpisodesRequest::default()
    };
    let episodes = every_page(client, request).await?.episodes;
    let changes = changes(&rows, &episodes)
        .map_err(|problem| Failure::message(format!("{}: {problem}; no label was changed", file.display())))?;
    let mut changed = Vec::new();
    for ((outcome, cohort), episode_ids) in changes {
        let request = LabelEpisodesRequest {
            episode_ids,
            outcome,
            cohort,
            author: context.connection.author(),
            reason: reason.into(),
        };
        changed.extend(client.episodes().label_episodes(request).await?.into_inner().episodes);
    }
    context.output.note(format_args!("{} of {} labels of {} are new", changed.len(), rows.len(), file.display()));
    Ok(changed)
}

/// The ids of the episodes for each new label: an outcome, and a cohort if that changes too.
type Changes = BTreeMap<(i32, Option<String>), Vec<String>>;

/// The episodes of each label that is not theirs yet. A label without a cohort keeps the episode's.
fn changes(rows: &[LabelledFile], episodes: &[Episode]) -> std::result::Result<Changes, String> {
    let mut by_name: BTreeMap<&str, Vec<&Episode>> = BTreeMap::new();
    for episode in episodes {
        by_name.entry(stem(&episode.file_name)).or_default().push(episode);
        by_name.entry(&episode.id).or_default().push(episode);
    }
    let (mut missing, mut ambiguous) = (Vec::new(), Vec::new());
    let mut changes = Changes::new();
    let mut named = BTreeSet::new();
    for row in rows {
        let name = row.path.file_name().unwrap_or_default().to_string_lossy();
        match by_name.get(stem(&name)).map(Vec::as_slice) {
            None | Some([]) => missing.push(format!("{name} (line {})", row.line)),
            Some([episode]) => {
                if !named.insert(&episode.id) {
                    return Err(format!("line {}: {name} names {} a second time", row.line, episode.id));
                }
                let cohort = Some(row.cohort.clone()).filter(|cohort| !cohort.is_empty());
                let same = episode.outcome == i32::from(row.outcome)
                    && cohort.as_ref().is_none_or(|cohort| *cohort == episode.cohort);
                if !same {
                    changes.entry((row.outcome.into(), cohort)).or_default().push(episode.id.clone());
                }
            }
            Some(_) => ambiguous.push(format!("{name} (line {})", row.line)),
        }
    }
    if !missing.is_empty() {
        return Err(format!("no episode of the task has the id or file name {}", words::some(&missing)));
    }
    if !ambiguous.is_empty() {
        return Err(format!("several episodes have the name {}: give their ids", words::some(&ambiguous)));
    }
    Ok(changes)
}

#[cfg(test)]
mod tests {
    use gleaner_proto::v1::Outcome;

    use super::*;

    fn row(line: u64, path: &str, outcome: Outcome, cohort: &str) -> LabelledFile {
        LabelledFile { path: path.into(), line, task: None, outcome, cohort: cohort.into() }
    }

    fn episode(id: &str, file_name: &str, outcome: Outcome, cohort: &str) -> Episode {
        Episode {
            id: id.into(),
            file_name: file_name.into(),
            outcome: outcome.into(),
            cohort: cohort.into(),
            ..Episode::default()
        }
    }

    #[test]
    fn labels_that_are_new_are_grouped() {
        let episodes = [
            episode("ep_1", "a.mcap", Outcome::Unknown, "day"),
            episode("ep_2", "b.mcap", Outcome::Success, "day"),
            episode("ep_3", "bag", Outcome::Unknown, "day"),
            episode("ep_4", "d.mcap", Outcome::Unknown, "day"),
        ];
        let rows = [
            row(2, "sub/a.mcap", Outcome::Success, ""),
            row(3, "b", Outcome::Success, "day"),
            row(4, "/data/bag", Outcome::Success, ""),
            row(5, "ep_4", Outcome::Failure, "night"),
        ];
        let expected = [
            ((Outcome::Success.into(), None), vec!["ep_1".to_owned(), "ep_3".to_owned()]),
            ((Outcome::Failure.into(), Some("night".to_owned())), vec!["ep_4".to_owned()]),
        ];
        assert_eq!(changes(&rows, &episodes).unwrap(), BTreeMap::from(expected));
    }

    #[test]
    fn a_row_without_its_one_episode_is_named() {
        let episodes =
            [episode("ep_1", "a.mcap", Outcome::Unknown, ""), episode("ep_2", "a.mcap", Outcome::Unknown, "")];
        let refused = |path| changes(&[row(7, path, Outcome::Success, "")], &episodes).unwrap_err();
        assert_eq!(refused("c.mcap"), "no episode of the task has the id or file name c.mcap (line 7)");
        assert_eq!(refused("x/a.mcap"), "several episodes have the name a.mcap (line 7): give their ids");
        let twice = [row(2, "ep_1", Outcome::Success, ""), row(3, "x/ep_1", Outcome::Failure, "")];
        assert!(changes(&twice, &episodes).unwrap_err().starts_with("line 3: ep_1 names ep_1 a second time"));
        let many: Vec<LabelledFile> =
            (2..10).map(|line| row(line, &format!("{line}.mcap"), Outcome::Success, "")).collect();
        assert!(changes(&many, &episodes).unwrap_err().ends_with("6.mcap (line 6) and 3 more"));
    }
}
