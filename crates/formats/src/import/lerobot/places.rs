//! Where each episode lies: its rows in a data file, and its part of each video.

use std::collections::BTreeMap;
use std::ops::{Range, RangeInclusive};
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::features::{Features, Source};
use super::info::Info;
use super::lines;
use super::tables::{Cells, Table, tables};
use super::{count, unfit};
use crate::problem::Problem;

/// Where an episode lies.
#[derive(Clone, Debug)]
pub(super) struct Place {
    pub(super) episode: u64,
    /// Number of rows.
    pub(super) steps: u64,
    /// The data file, within the dataset.
    pub(super) data: PathBuf,
    /// Its first row in the data file.
    pub(super) first_row: u64,
    /// Its videos, by feature.
    pub(super) videos: BTreeMap<String, VideoPart>,
}

/// A part of a video.
#[derive(Clone, Debug)]
pub(super) struct VideoPart {
    /// The file, within the dataset.
    pub(super) path: PathBuf,
    /// Seconds at which the episode begins.
    pub(super) from: f64,
}

/// The folder with the tables of episodes, and the file before v3.0.
const TABLES: &str = "meta/episodes";
const LINES: &str = "meta/episodes.jsonl";
/// The column with the numbers of episodes, also in data files.
pub(super) const NUMBER: &str = "episode_index";

/// The places of all episodes, by their numbers.
pub(super) fn read(folder: &Path, info: &Info, features: &Features) -> Result<Vec<Place>, Problem> {
    let rows = rows(folder, info, features, None)?;
    let mut rows: Vec<EpisodeRow<'_>> = rows.iter().map(EpisodeRow).collect();
    rows.sort_by_key(|row| row.whole(NUMBER));
    let mut places = Vec::with_capacity(rows.len());
    for (episode, row) in rows.iter().enumerate() {
        let episode = count(episode);
        if row.whole(NUMBER) != Some(episode) {
            return Err(unfit(
                folder,
                &format!("meta/episodes has no episode {episode}, or has it twice; download it again"),
            ));
        }
        places.push(place(folder, info, features, episode, row.0)?);
    }
    if count(places.len()) != info.total_episodes || places.is_empty() {
        let problem = format!(
            "meta/info.json states {} episodes, and meta/episodes has {}; download the whole dataset",
            info.total_episodes,
            places.len()
        );
        return Err(unfit(folder, &problem));
    }
    if info.shares_files() {
        // Rows are numbered over all files; the first episode of a file begins it.
        let mut begins: BTreeMap<PathBuf, u64> = BTreeMap::new();
        for place in &places {
            let begin = begins.entry(place.data.clone()).or_insert(place.first_row);
            *begin = place.first_row.min(*begin);
        }
        for place in &mut places {
            place.first_row -= begins.get(&place.data).copied().unwrap_or_default();
        }
    }
    Ok(places)
}

/// The rows of the tables for some episodes, of each number that one row has. Parts of the tables without these numbers are
/// not decoded; lines are taken to be in the order of their numbers, with those of one number side by side. `read` names the
/// fault where an episode has no row here.
pub(super) fn find(
    folder: &Path,
    info: &Info,
    features: &Features,
    episodes: &Range<u64>,
) -> Result<BTreeMap<u64, Cells>, Problem> {
    let number = |episode| i64::try_from(episode).ok();
    let Some((first, last)) = number(episodes.start).zip(episodes.end.checked_sub(1).and_then(number)) else {
        return Ok(BTreeMap::new());
    };
    let mut found: BTreeMap<u64, Vec<Cells>> = BTreeMap::new();
    for row in rows(folder, info, features, Some(&(first..=last)))? {
        if let Some(episode) = EpisodeRow(&row).whole(NUMBER) {
            found.entry(episode).or_default().push(row);
        }
    }
    let one = |(episode, rows)| <[Cells; 1]>::try_from(rows).ok().map(|[row]| (episode, row));
    Ok(found.into_iter().filter_map(one).collect())
}

/// The rows of the tables of episodes: all, or those with some numbers.
fn rows(
    folder: &Path,
    info: &Info,
    features: &Features,
    wanted: Option<&RangeInclusive<i64>>,
) -> Result<Vec<Cells>, Problem> {
    let (mut rows, mut length) = (Vec::new(), 0_u64);
    if !info.shares_files() {
        let path = folder.join(LINES);
        let Some(numbers) = wanted else { return lines::rows(&path) };
        for number in numbers.clone() {
            rows.extend(lines::rows_with(&path, NUMBER, number)?);
        }
        return Ok(rows);
    }
    let columns = columns(features);
    for path in tables(&folder.join(TABLES))? {
        let table = Table::open(&path)?;
        length = length.saturating_add(table.length());
        rows.extend(table.rows(&columns, wanted.map(|numbers| (NUMBER, numbers)))?);
    }
    if wanted.is_some() && length != info.total_episodes {
        // The reader of all rows names the difference.
        rows.clear();
    }
    Ok(rows)
}

/// What a table of episodes states of one.
struct EpisodeRow<'a>(&'a Cells);

impl EpisodeRow<'_> {
    fn whole(&self, name: &str) -> Option<u64> {
        self.0.get(name)?.as_u64()
    }

    fn needed(&self, folder: &Path, name: &str) -> Result<u64, Problem> {
        let episode = self.whole(NUMBER).unwrap_or_default();
        let problem = format!("meta/episodes: episode {episode} has no sound {name}; download the dataset again");
        self.whole(name).ok_or_else(|| unfit(folder, &problem))
    }
}

fn columns(features: &Features) -> Vec<String> {
    let mut columns: Vec<String> =
        [NUMBER, "length", "data/chunk_index", "data/file_index", "dataset_from_index"].map(str::to_owned).into();
    for picture in features.pictures.iter().filter(|picture| picture.source == Source::Video) {
        for part in ["chunk_index", "file_index", "from_timestamp"] {
            columns.push(format!("videos/{}/{part}", picture.feature));
        }
    }
    columns
}

/// The place of an episode by its row in the tables of episodes; its first row is counted over all data files.
pub(super) fn place(
    folder: &Path,
    info: &Info,
    features: &Features,
    episode: u64,
    row: &Cells,
) -> Result<Place, Problem> {
    let row = EpisodeRow(row);
    let filled = |template: &str, values: &[(&str, &str)]| {
        Info::fill(template, values).ok_or_else(|| {
            unfit(folder, &format!("meta/info.json: the path {template:?} is not one within the dataset; correct it"))
        })
    };
    let number = episode.to_string();
    let mut videos = BTreeMap::new();
    let template = info.video_path.as_deref().unwrap_or_default();
    let chunk_of_episode = (episode / info.chunks_size.unwrap_or(1000).max(1)).to_string();
    let of_video = features.pictures.iter().filter(|picture| picture.source == Source::Video);
    for feature in of_video.map(|picture| picture.feature.as_str()) {
        let part = if info.shares_files() {
            let of = |part: &str| row.needed(folder, &format!("videos/{feature}/{part}"));
            let (chunk, file) = (of("chunk_index")?.to_string(), of("file_index")?.to_string());
            let path = filled(template, &[("video_key", feature), ("chunk_index", &chunk), ("file_index", &file)])?;
            let from = row.0.get(&format!("videos/{feature}/from_timestamp")).and_then(Value::as_f64);
            let from = from.filter(|from| from.is_finite() && *from >= 0.0);
            let problem = format!("meta/episodes: episode {episode} has no sound from_timestamp of {feature}");
            VideoPart { path, from: from.ok_or_else(|| unfit(folder, &problem))? }
        } else {
            let values = [("video_key", feature), ("episode_chunk", &chunk_of_episode), ("episode_index", &number)];
            VideoPart { path: filled(template, &values)?, from: 0.0 }
        };
        videos.insert(feature.to_owned(), part);
    }
    let (data, first_row) = if info.shares_files() {
        let of = |name: &str| row.needed(folder, name);
        let (chunk, file) = (of("data/chunk_index")?.to_string(), of("data/file_index")?.to_string());
        (filled(&info.data_path, &[("chunk_index", &chunk), ("file_index", &file)])?, of("dataset_from_index")?)
    } else {
        (filled(&info.data_path, &[("episode_chunk", &chunk_of_episode), ("episode_index", &number)])?, 0)
    };
    Ok(Place { episode, steps: row.needed(folder, "length")?, data, first_row, videos })
}
