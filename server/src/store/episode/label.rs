//! Labels: given to many episodes in one transaction, with a full history.

use std::collections::HashSet;

use super::{
    by_id, fault,
    row::{self, Column as _, Record as _, record},
    sql::{self, Transaction},
};
use crate::{
    domain::{
        curation::{Labelled, Overtaken},
        episode::{Episode, Label, NewLabel},
        id::EpisodeId,
        time::Millis,
    },
    error::{Error, Result},
    store::Store,
};

record! { Label: outcome, cohort, author, reason, created_at }

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
        for (episode_id, version) in seen {
            if let Some((label_version, label)) = newest(&mut tx, episode_id).await?
                && label_version != *version
            {
                changed.push(Overtaken { episode_id: episode_id.clone(), label_version, label });
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
        let labels: Vec<Label> = sql::query("select * from labels where episode_id = $1 order by id")
            .bind(id.param())
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("listing labels"))?;
        if labels.is_empty() {
            // Every episode has at least one label.
            return Err(Error::not_found("episode", id));
        }
        Ok(labels)
    }
}

/// Labels each of these once; returns each with its new version.
async fn label_all(
    tx: &mut Transaction,
    ids: impl Iterator<Item = &EpisodeId>,
    label: &NewLabel,
) -> Result<Vec<(Episode, i64)>> {
    let (mut labelled, mut named) = (Vec::new(), HashSet::new());
    for id in ids {
        if !named.insert(id) {
            continue;
        }
        let mut episode = by_id(tx, id)
            .await?
            .ok_or_else(|| Error::not_found("episode", format!("{id}; no episode was labelled")))?;
        if episode.deleted_at.is_some() {
            return Err(Error::precondition(format!(
                "{id} is in the trash; no episode was labelled. Restore it first"
            )));
        }
        episode.outcome = label.outcome;
        if let Some(cohort) = &label.cohort {
            episode.cohort.clone_from(cohort);
        }
        sql::query("update episodes set outcome = $1, cohort = $2 where id = $3")
            .bind(episode.outcome.param())
            .bind(&episode.cohort)
            .bind(id.param())
            .execute(&mut *tx)
            .await
            .map_err(fault("labelling an episode"))?;
        let version = insert(tx, &episode, &label.author, &label.reason).await?;
        labelled.push((episode, version));
    }
    Ok(labelled)
}

/// An episode's newest label, with its version.
async fn newest(tx: &mut Transaction, id: &EpisodeId) -> Result<Option<(i64, Label)>> {
    sql::query("select * from labels where episode_id = $1 order by id desc limit 1")
        .bind(id.param())
        .try_map(|row| Ok((row::column(&row, "id")?, Label::decode(&row)?)))
        .fetch_optional(&mut *tx)
        .await
        .map_err(fault("reading a label"))
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
