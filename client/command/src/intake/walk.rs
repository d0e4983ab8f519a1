//! The episodes of a dataset as recordings, a run of neighbours for each child: a child reads what all episodes have in
//! common, such as the footers of their tables, once.
//!
//! On the disk are the recordings of one run: what a child writes before it ends a run, and one episode.

use std::collections::VecDeque;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use gleaner_client::ClientError;
use gleaner_inspector::{Converted, run_file};
use tempfile::TempDir;

use super::Intake;
use crate::failure::Result;

/// Runs of a dataset: few, since each reads what all episodes have in common, and enough for several at once.
const RUNS: u64 = 64;

/// An episode as a recording, which is there as long as this is.
#[derive(Debug)]
pub(crate) struct Episode {
    pub(crate) recording: PathBuf,
    pub(crate) converted: Converted,
    _folder: Arc<TempDir>,
}

/// A recording, or why the episode cannot be used.
pub(crate) type Conversion = std::result::Result<Episode, String>;

/// Episodes that are made recordings, in order.
#[derive(Debug)]
pub(crate) struct Walk<'a> {
    intake: &'a Intake,
    /// Those that no child has converted yet.
    left: Range<u64>,
    /// The most of the next child.
    most: u64,
    made: VecDeque<(u64, Conversion)>,
}

impl Intake {
    /// Its episodes in runs of neighbours.
    pub(crate) fn runs(&self) -> impl Iterator<Item = Range<u64>> + use<> {
        let episodes = self.description.episodes;
        let length = episodes.div_ceil(RUNS).max(1);
        (0..episodes.div_ceil(length)).map(move |run| run * length..((run + 1) * length).min(episodes))
    }

    /// Makes the recordings of neighbouring episodes.
    pub(crate) fn walk(&self, episodes: Range<u64>) -> Walk<'_> {
        Walk { intake: self, left: episodes, most: u64::MAX, made: VecDeque::new() }
    }

    /// Makes the recording of one episode.
    pub(crate) async fn episode(&self, episode: u64) -> Result<Conversion> {
        let made = self.walk(episode..episode.saturating_add(1)).next().await?;
        Ok(made.map_or_else(|| Err(format!("there is no episode {episode}")), |(_, made)| made))
    }
}

impl Walk<'_> {
    /// The next episode with its number; `None` after the last.
    pub(crate) async fn next(&mut self) -> Result<Option<(u64, Conversion)>> {
        while self.made.is_empty() && !self.left.is_empty() {
            self.convert().await?;
        }
        Ok(self.made.pop_front())
    }

    /// Starts a child for the next episodes. One that dies has no results, so the next one has half as many episodes, until
    /// the episode that is the cause is alone.
    async fn convert(&mut self) -> Result<()> {
        let first = self.left.start;
        let end = first.saturating_add(self.most).min(self.left.end);
        let folder = Arc::new(tempfile::tempdir()?);
        let Intake { path, assumed, inspector, .. } = self.intake;
        let results = inspector.convert(path, assumed, first..end, folder.path()).await?;
        match results {
            Ok(results) if !results.is_empty() => {
                for (episode, converted) in (first..end).zip(results) {
                    let made = match converted {
                        Ok(converted) => Ok(self.named(episode, converted, &folder)?),
                        Err(why) => Err(why),
                    };
                    self.made.push_back((episode, made));
                    self.left.start = episode + 1;
                }
                self.most = self.most.saturating_mul(2);
            }
            Ok(_) | Err(_) if end - first > 1 => self.most = (end - first) / 2,
            Ok(_) => self.fail(first, "the inspector has no result; install gleaner-inspector of the same version"),
            Err(why) => self.fail(first, &why),
        }
        Ok(())
    }

    /// The recording under the name that it has at the server.
    fn named(&self, episode: u64, converted: Converted, folder: &Arc<TempDir>) -> Result<Episode> {
        let recording = folder.path().join(format!("{}.mcap", self.intake.stem(episode)));
        let written = run_file(folder.path(), episode);
        std::fs::rename(&written, &recording).map_err(ClientError::io(&written))?;
        Ok(Episode { recording, converted, _folder: Arc::clone(folder) })
    }

    fn fail(&mut self, episode: u64, why: &str) {
        self.made.push_back((episode, Err(why.to_owned())));
        self.left.start = episode + 1;
    }
}

#[cfg(test)]
mod tests;
