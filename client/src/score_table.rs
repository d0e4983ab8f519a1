//! Scores made elsewhere, from a CSV or Parquet file of episode, step and q.
//!
//! Reads the file system; must not know a server.

mod parquet;

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read as _, Seek as _};
use std::path::Path;

use serde::Deserialize;

use crate::error::{ClientError, Result};
use crate::file::open_regular;

/// The columns of a file.
const COLUMNS: [&str; 3] = ["episode", "step", "q"];
/// The first bytes of a Parquet file.
const PARQUET: &[u8] = b"PAR1";

/// The scores of one episode.
#[derive(Clone, Debug, PartialEq)]
pub struct ScoredEpisode {
    /// Its id, or the file name or BLAKE3 digest of its recording.
    pub episode: String,
    /// q of each step, from step 0 on.
    pub q: Vec<f64>,
}

#[derive(Deserialize)]
struct Row {
    episode: String,
    step: u64,
    q: f64,
}

/// Reads the scores of a CSV or Parquet file (columns episode, step, q; others are ignored). The rows may be in any order;
/// steps count from 0.
///
/// # Errors
/// [`ClientError::Io`] when it can't be read; [`ClientError::Invalid`] when it has no scores, and otherwise names a missing
/// column, the line or row that is wrong, or the episode and the step that is missing or listed twice.
pub fn read_scores(path: &Path) -> Result<Vec<ScoredEpisode>> {
    let io = |error| ClientError::io(path)(error);
    let wrong = |problem: String| ClientError::Invalid(format!("{}: {problem}", path.display()));
    let mut file = open_regular(path)?;
    let mut first = Vec::new();
    (&mut file).take(PARQUET.len() as u64).read_to_end(&mut first).map_err(io)?;
    file.rewind().map_err(io)?;
    let mut episodes = Episodes::default();
    if first == PARQUET { parquet::read(file, &mut episodes) } else { read_csv(file, &mut episodes) }.map_err(wrong)?;
    episodes.whole().map_err(wrong)
}

fn read_csv(file: File, episodes: &mut Episodes) -> std::result::Result<(), String> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(BufReader::new(file));
    let headers = reader.byte_headers().map_err(|error| error.to_string())?;
    for needed in COLUMNS {
        if !headers.iter().any(|header| header == needed.as_bytes()) {
            return Err(format!("column {needed:?} is missing; the first line must be {}", COLUMNS.join(",")));
        }
    }
    for row in reader.deserialize() {
        episodes.add(row.map_err(|error| error.to_string())?);
    }
    Ok(())
}

/// The rows of each episode so far, in the order in which the episodes appear.
#[derive(Default)]
struct Episodes {
    places: HashMap<String, usize>,
    rows: Vec<(String, Vec<(u64, f64)>)>,
}

impl Episodes {
    fn add(&mut self, Row { episode, step, q }: Row) {
        let place = *self.places.entry(episode).or_insert_with_key(|episode| {
            self.rows.push((episode.clone(), Vec::new()));
            self.rows.len() - 1
        });
        if let Some((_, scores)) = self.rows.get_mut(place) {
            scores.push((step, q));
        }
    }

    fn whole(self) -> std::result::Result<Vec<ScoredEpisode>, String> {
        if self.rows.is_empty() {
            return Err("has no scores; list every step of the episodes".into());
        }
        self.rows.into_iter().map(|(episode, scores)| whole(episode, scores)).collect()
    }
}

/// The scores of an episode in the order of its steps.
fn whole(episode: String, mut scores: Vec<(u64, f64)>) -> std::result::Result<ScoredEpisode, String> {
    scores.sort_by_key(|(step, _)| *step);
    for ((step, _), expected) in scores.iter().zip(0..) {
        if *step < expected {
            return Err(format!("step {step} of {episode} is listed twice; keep one row"));
        }
        if *step > expected {
            return Err(format!("step {expected} of {episode} is missing; list every step, counted from 0"));
        }
    }
    Ok(ScoredEpisode { episode, q: scores.into_iter().map(|(_, q)| q).collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<ScoredEpisode>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scores.csv");
        std::fs::write(&path, text).unwrap();
        read_scores(&path)
    }

    #[test]
    fn lines_and_columns_may_be_in_any_order() {
        let read = read("q, step, note, episode\n0.5,1,x,b.mcap\n1,0,,a.mcap\n0.25,0,,b.mcap\n").unwrap();
        let of = |episode: &str, q: &[f64]| ScoredEpisode { episode: episode.into(), q: q.to_vec() };
        assert_eq!(read, [of("b.mcap", &[0.25, 0.5]), of("a.mcap", &[1.0])]);
    }

    #[test]
    fn a_wrong_line_or_step_is_named() {
        for (text, part) in [
            ("", "column \"episode\" is missing"),
            ("episode,step,q\n", "has no scores"),
            ("episode,step,w\na,0,1\n", "column \"q\" is missing"),
            ("episode,step,q\na,0,1\na,one,1\n", "line: 3"),
            ("episode,step,q\na,-1,1\n", "line: 2"),
            ("episode,step,q\na,0,\n", "line: 2"),
            ("episode,step,q\na,0,1\na,0,1\n", "step 0 of a is listed twice"),
            ("episode,step,q\na,0,1\nb,0,1\na,2,1\n", "step 1 of a is missing"),
            ("PAR1\u{15}\u{4}\u{15}", "Parquet"),
            ("PAR1", "Parquet"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains(part) && message.contains("scores.csv"), "{part:?} expected: {message}");
        }
    }
}
