//! Episodes that a page names: whether each still has a page of its own, and the tag of one that was deleted.

use std::collections::{HashMap, HashSet};

use gleaner_core::{Result, curation::Standing, error::Kind, id::EpisodeId};
use maud::{Markup, html};

use super::Backend;

/// The standings of the episodes that a page names; present ones are left out.
#[derive(Debug, Default)]
pub(super) struct Standings(HashMap<EpisodeId, Standing>);

impl Standings {
    /// Reads the standings of these episodes.
    ///
    /// # Errors
    /// Internal.
    pub(super) async fn of(backend: &dyn Backend, ids: &[EpisodeId]) -> Result<Self> {
        if ids.is_empty() {
            return Ok(Self::default());
        }
        let rows = backend.episode_rows(ids).await?;
        let known: HashSet<&EpisodeId> = rows.iter().map(|row| &row.episode.id).collect();
        let removed = ids.iter().filter(|id| !known.contains(id));
        let mut standings: HashMap<_, _> = removed.map(|id| (id.clone(), Standing::Deleted)).collect();
        for row in rows.iter().filter(|row| row.episode.deleted_at.is_some()) {
            let id = &row.episode.id;
            let standing = match backend.task_of_episode(id).await {
                Ok(_) => Standing::InTrash,
                Err(error) if error.kind() == Kind::NotFound => Standing::Deleted,
                Err(error) => return Err(error),
            };
            standings.insert(id.clone(), standing);
        }
        Ok(Self(standings))
    }

    /// Whether the episode has a page: one in the trash has, a permanently deleted one has not.
    pub(super) fn has_page(&self, id: &EpisodeId) -> bool {
        self.0.get(id) != Some(&Standing::Deleted)
    }

    /// The permanently deleted episodes, in no order.
    pub(super) fn deleted(&self) -> Vec<&EpisodeId> {
        self.0.keys().filter(|id| !self.has_page(id)).collect()
    }

    /// The tag of an episode, with a space before it; empty for a present one.
    pub(super) fn tag(&self, id: &EpisodeId) -> Markup {
        tag(self.0.get(id).copied().unwrap_or(Standing::Present))
    }
}

/// The tag of a standing, with a space before it; empty for a present episode.
pub(super) fn tag(standing: Standing) -> Markup {
    html! {
        @match standing {
            Standing::Present => {},
            Standing::InTrash => { " " span.tag.warned { "in the trash" } },
            Standing::Deleted => { " " span.tag.warned { "recording deleted" } },
        }
    }
}
