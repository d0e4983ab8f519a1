//! What neighbouring episodes share: each footer of a table and the tables of each video are read once for a run of them.
//!
//! A run keeps the rows of up to `NOTED` episodes in the tables of episodes, one data file's footer and reader, one video of
//! each camera, and texts of tasks. Damage in a part of a file that other episodes alone need is no error of an episode.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use super::features::Features;
use super::places::{self, NUMBER, Place};
use super::rows::{Row, Rows};
use super::tables::{Cells, Table};
use super::tasks::Texts;
use super::{Lerobot, unfit};
use crate::import::mp4::Film;
use crate::problem::Problem;

/// Most episodes whose rows in the tables of episodes are kept.
const NOTED: u64 = 4096;

/// The state that one episode leaves to the next.
#[derive(Default)]
pub(super) struct Run {
    /// The episodes whose rows in the tables of episodes have been looked for, and the rows found.
    noted: Range<u64>,
    found: BTreeMap<u64, Cells>,
    /// The places of all episodes, once one has been needed that its number does not give.
    all: Vec<Place>,
    data: Option<Data>,
    /// The last video of each camera, by feature.
    films: BTreeMap<String, Rc<Film>>,
    pub(super) texts: Texts,
}

/// A data file that is being read.
struct Data {
    /// Within the dataset.
    path: PathBuf,
    table: Table,
    /// The first rows of some episodes.
    first_rows: BTreeMap<i64, u64>,
    rows: Option<Rows>,
    /// The first episode that is not in the run.
    end: u64,
}

impl Run {
    /// The place of the first of these episodes, whose data file is opened: by its number, or by all tables where that is
    /// not enough.
    pub(super) fn place(&mut self, set: &Lerobot, episodes: &Range<u64>) -> Result<Place, Problem> {
        if let Some(place) = self.numbered(set, episodes)? {
            return Ok(place);
        }
        if self.all.is_empty() {
            self.all = places::read(&set.folder, &set.info, &set.features)?;
        }
        let episode = episodes.start;
        let place = usize::try_from(episode).ok().and_then(|at| self.all.get(at)).cloned();
        let place = place.ok_or_else(|| unfit(&set.folder, &format!("there is no episode {episode}")))?;
        self.open(set, &place.data, episodes)?;
        Ok(place)
    }

    /// The place of the first of these episodes if one row of the tables, and a row of the data file, has its number.
    fn numbered(&mut self, set: &Lerobot, episodes: &Range<u64>) -> Result<Option<Place>, Problem> {
        let episode = episodes.start;
        if !self.noted.contains(&episode) {
            self.note(set, episodes)?;
        }
        let Some((row, number)) = self.found.get(&episode).zip(i64::try_from(episode).ok()) else { return Ok(None) };
        let place = places::place(&set.folder, &set.info, &set.features, episode, row)?;
        let data = self.open(set, &place.data, episodes)?;
        if !set.info.shares_files() {
            return Ok(Some(place));
        }
        // Numbers that are no feature may be those of another dataset.
        if !set.info.features.contains_key(NUMBER) {
            return Ok(None);
        }
        let first_row = match data.first_rows.get(&number) {
            Some(first_row) => Some(*first_row),
            None => data.table.first_rows((NUMBER, &(number..=number)))?.remove(&number),
        };
        Ok(first_row.map(|first_row| Place { first_row, ..place }))
    }

    /// Looks for the rows of these episodes in the tables of episodes; where that fails, for those of the first.
    fn note(&mut self, set: &Lerobot, episodes: &Range<u64>) -> Result<(), Problem> {
        let first = episodes.start;
        let find = |episodes: Range<u64>| {
            let found = places::find(&set.folder, &set.info, &set.features, &episodes);
            found.map(|found| (episodes, found))
        };
        // Lines are found one by one.
        let most = if set.info.shares_files() { NOTED } else { 1 };
        let several = find(first..episodes.end.min(first.saturating_add(most)));
        (self.noted, self.found) = several.or_else(|_| find(first..first.saturating_add(1)))?;
        Ok(())
    }

    /// The data file, opened unless the episode before it in the run was in it.
    fn open(&mut self, set: &Lerobot, path: &Path, episodes: &Range<u64>) -> Result<&mut Data, Problem> {
        let data = match self.data.take().filter(|data| data.path == path && data.end == episodes.end) {
            Some(data) => data,
            None => Data::open(set, path, episodes)?,
        };
        Ok(self.data.insert(data))
    }

    /// A step of an episode whose place was the last one that was asked for; `None` after its last.
    pub(super) fn row(&mut self, set: &Lerobot, place: &Place, step: u64) -> Result<Option<Row>, Problem> {
        let Some(data) = self.data.as_mut().filter(|_| step < place.steps) else { return Ok(None) };
        data.row(&set.features, place, step)
    }

    /// The video of a camera.
    pub(super) fn film(&mut self, feature: &str, path: &Path) -> Result<Rc<Film>, Problem> {
        let film = match self.films.remove(feature).filter(|film| film.path == path) {
            Some(film) => film,
            None => Rc::new(Film::open(path)?),
        };
        self.films.insert(feature.to_owned(), Rc::clone(&film));
        Ok(film)
    }
}

impl Data {
    fn open(set: &Lerobot, path: &Path, episodes: &Range<u64>) -> Result<Self, Problem> {
        let table = Table::open(&set.folder.join(path))?;
        let shared = set.info.shares_files() && set.info.features.contains_key(NUMBER);
        let number = |episode| i64::try_from(episode).ok();
        let numbers = number(episodes.start).zip(episodes.end.checked_sub(1).and_then(number)).filter(|_| shared);
        // Those that are not found here are looked for again, one by one.
        let found = numbers.and_then(|(first, last)| table.first_rows((NUMBER, &(first..=last))).ok());
        let first_rows = found.unwrap_or_default();
        Ok(Self { path: path.to_owned(), table, first_rows, rows: None, end: episodes.end })
    }

    /// A step of an episode. Where the rows are those that come next, the reader of the episode before continues.
    fn row(&mut self, features: &Features, place: &Place, step: u64) -> Result<Option<Row>, Problem> {
        let (at, left) = (place.first_row.saturating_add(step), place.steps.saturating_sub(step));
        let end = at.saturating_add(left);
        let next = |mut rows: Rows| rows.next(features, place, step).map(|row| (rows, row));
        let open = |rows| Rows::open(&self.table, features, at, rows).and_then(next);
        let kept = self.rows.take().filter(|rows| rows.at == at && rows.end >= end);
        // The reader of an episode that others follow continues up to the end of the file.
        let followed = place.episode.saturating_add(1) < self.end;
        let most = if followed { self.table.length().saturating_sub(at).max(left) } else { left };
        let ahead = kept.as_ref().map_or(most > left, |rows| rows.end > end);
        let (rows, row) = match kept.map_or_else(|| open(most), next) {
            // Rows of the next episodes may be the ones that are damaged: up to a batch of them is read ahead.
            Err(_) if ahead => open(left)?,
            read => read?,
        };
        self.rows = Some(rows);
        Ok(row)
    }
}
