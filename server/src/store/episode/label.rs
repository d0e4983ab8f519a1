//! Labels: given to many episodes in one transaction, with a full history.

use std::collections::{HashMap, HashSet};

use super::{
    BATCH, by_ids, fault,
    row::{self, Column as _, Record as _, record},
    sql::{self, QueryBuilder, Transaction},
};
use crate::{
    domain::{
        curation::{Labelled, Overtaken},
        episode::{Episode, Label, NewLabel},
        id::EpisodeId,
        page::Page,
        time::Millis,
    },
    error::{Error, Result},
    store::Store,
};

record! { Label: outcome, cohort, author, reason, created_at }
record! { NumberedLabel: id; label }

/// A label with its number, which grows with time.
struct NumberedLabel {
    id: i64,
    label: Label,
}

impl Store {
    /// Labels all these episodes or, when one is unknown, none. Every change is stored. The result is in the order of
    /// `ids`; an id that occurs twice is labelled once.
    ///
    /// # Errors
    /// NotFound names the first unknown episode; Precondition the first that is in the trash.
    pub(crate) async fn label_episodes(&self, ids: &[EpisodeId], label: &NewLabel) -> Result<Vec<Episode>> {
        let mut tx = self.write().await?;
        let labelled = label_all(&mut tx, ids.iter(), label).await?;
        self.commit_labels(tx).await?;
        Ok(labelled.into_iter().map(|(episode, _)| episode).collect())
    }

    /// Labels all these episodes if each still has the given version of its label; otherwise none, and returns the
    /// newer labels.
    ///
    /// # Errors
    /// As for [`Store::label_episodes`].
    pub(crate) async fn label_episodes_as_seen(&self, seen: &[(EpisodeId, i64)], label: &NewLabel) -> Result<Labelled> {
        let mut tx = self.write().await?;
        let mut changed = Vec::new();
        for part in seen.chunks(BATCH) {
            let newest = newest(&mut tx, part.iter().map(|(id, _)| id)).await?;
            for (episode_id, version) in part {
                if let Some((label_version, label)) = newest.get(episode_id)
                    && label_version != version
                {
                    let (label_version, label) = (*label_version, label.clone());
                    changed.push(Overtaken { episode_id: episode_id.clone(), label_version, label });
                }
            }
        }
        if !changed.is_empty() {
            return Ok(Labelled::Changed(changed));
        }
        let labelled = label_all(&mut tx, seen.iter().map(|(id, _)| id), label).await?;
        self.commit_labels(tx).await?;
        Ok(Labelled::Done(labelled))
    }

    async fn commit_labels(&self, tx: Transaction) -> Result<()> {
        crate::fail_point::pass("label.rows_written");
        self.commit_generation(tx).await?;
        crate::fail_point::pass("label.committed");
        Ok(())
    }

    /// Every label an episode ever had, oldest first.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn labels(&self, id: &EpisodeId) -> Result<Vec<Label>> {
        Ok(self.labels_page(id, &Page::whole()).await?.0)
    }

    /// A page of the labels that an episode ever had, oldest first, and the number of the label that the next one follows.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn labels_page(&self, id: &EpisodeId, page: &Page<i64>) -> Result<(Vec<Label>, Option<i64>)> {
        let labels: Vec<NumberedLabel> =
            sql::query("select * from labels where episode_id = $1 and id > $2 order by id limit $3")
                .bind(id.param())
                .bind(page.after.unwrap_or(0))
                .bind(page.rows())
                .try_map(row::read)
                .fetch_all(self.read())
                .await
                .map_err(fault("listing labels"))?;
        if labels.is_empty() {
            self.expect_labelled(id).await?;
        }
        let (labels, next) = page.cut(labels, |numbered| numbered.id);
        Ok((labels.into_iter().map(|numbered| numbered.label).collect(), next))
    }

    /// Checks that an episode exists: every one has at least one label.
    async fn expect_labelled(&self, id: &EpisodeId) -> Result<()> {
        let count: i64 = row::query_as("select count(*) from labels where episode_id = $1")
            .bind(id.param())
            .fetch_one(self.read())
            .await
            .map_err(fault("looking for an episode's labels"))?;
        if count == 0 { Err(Error::not_found("episode", id)) } else { Ok(()) }
    }
}

/// Labels each of these once; returns each with its new version.
async fn label_all(
    tx: &mut Transaction,
    ids: impl Iterator<Item = &EpisodeId>,
    label: &NewLabel,
) -> Result<Vec<(Episode, i64)>> {
    let mut named = HashSet::new();
    let ids: Vec<&EpisodeId> = ids.filter(|&id| named.insert(id)).collect();
    let mut labelled = Vec::with_capacity(ids.len());
    for part in ids.chunks(BATCH) {
        let mut found = by_ids(tx, part).await?;
        let mut episodes = Vec::with_capacity(part.len());
        for &id in part {
            let mut episode = found
                .remove(id)
                .ok_or_else(|| Error::not_found("episode", format!("{id}; no episode was labelled")))?;
            if episode.deleted_at.is_some() {
                return Err(Error::precondition(format!(
                    "{id} is in the trash; no episode was labelled. Restore it first"
                )));
            }
            episode.outcome = label.outcome.unwrap_or(episode.outcome);
            if let Some(cohort) = &label.cohort {
                episode.cohort.clone_from(cohort);
            }
            episodes.push(episode);
        }
        let (mut query, mut before) = (QueryBuilder::new(""), "update episodes set ");
        if let Some(outcome) = label.outcome {
            query.push(before).push("outcome = ").push_bind(outcome.param());
            before = ", ";
        }
        if let Some(cohort) = &label.cohort {
            query.push(before).push("cohort = ").push_bind(cohort);
        }
        query.push(" where id in (").push_list(part.iter().map(|id| id.as_str())).push(")");
        query.build().execute(&mut *tx).await.map_err(fault("labelling episodes"))?;
        let mut versions = insert_all(tx, &episodes, label).await?;
        for episode in episodes {
            let version = versions.remove(&episode.id);
            let version = version.ok_or_else(|| Error::internal("labelling episodes", "a label has no version"))?;
            labelled.push((episode, version));
        }
    }
    Ok(labelled)
}

/// The newest label of each of these episodes, with its version.
async fn newest(
    tx: &mut Transaction,
    ids: impl Iterator<Item = &EpisodeId>,
) -> Result<HashMap<EpisodeId, (i64, Label)>> {
    let mut query =
        QueryBuilder::new("select * from labels where id in (select max(id) from labels where episode_id in (");
    query.push_list(ids.map(EpisodeId::as_str)).push(") group by episode_id)");
    let found = query
        .build()
        .try_map(|row| Ok((row::column(&row, "episode_id")?, (row::column(&row, "id")?, Label::decode(&row)?))))
        .fetch_all(&mut *tx)
        .await
        .map_err(fault("reading labels"))?;
    Ok(found.into_iter().collect())
}

/// Adds the present labels of these episodes to their histories; returns their versions.
async fn insert_all(tx: &mut Transaction, episodes: &[Episode], label: &NewLabel) -> Result<HashMap<EpisodeId, i64>> {
    let now = Millis::now();
    let mut query =
        QueryBuilder::new("insert into labels (episode_id, outcome, cohort, author, reason, created_at) values ");
    for (place, episode) in episodes.iter().enumerate() {
        query.push(if place == 0 { "(" } else { ", (" });
        query.push_bind(episode.id.param()).push(", ").push_bind(episode.outcome.param()).push(", ");
        query.push_bind(&episode.cohort).push(", ").push_bind(&label.author).push(", ").push_bind(&label.reason);
        query.push(", ").push_bind(now.param()).push(")");
    }
    query.push(" returning episode_id, id");
    let added: Vec<(EpisodeId, i64)> =
        query.build().try_map(row::read).fetch_all(&mut *tx).await.map_err(fault("keeping labels"))?;
    Ok(added.into_iter().collect())
}

/// Moves the episode's present label to its history and returns its version.
pub(in crate::store) async fn insert(
    tx: &mut Transaction,
    episode: &Episode,
    author: &str,
    reason: &str,
) -> Result<i64> {
    sql::query(
        "insert into labels (episode_id, outcome, cohort, author, reason, created_at) values ($1, $2, $3, $4, $5, $6) \
         returning id",
    )
    .bind(episode.id.param())
    .bind(episode.outcome.param())
    .bind(&episode.cohort)
    .bind(author)
    .bind(reason)
    .bind(Millis::now().param())
    .try_map(row::read)
    .fetch_one(&mut *tx)
    .await
    .map_err(fault("keeping a label"))
}

#[cfg(test)]
mod tests;
