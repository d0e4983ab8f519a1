//! Rows of one episode of a data file, some at a time.

use std::path::PathBuf;

use arrow_array::RecordBatch;
use parquet::arrow::arrow_reader::ParquetRecordBatchReader;

use super::cells;
use super::features::Features;
use super::places::Place;
use super::tables::{Table, damaged};
use super::{Others, unfit};
use crate::problem::Problem;

/// Rows that are decoded at once: few, because each may have several pictures.
const ROWS: usize = 16;

/// One row.
#[derive(Debug)]
pub(super) struct Row {
    pub(super) state: Vec<f32>,
    pub(super) action: Vec<f32>,
    /// A file of an image for each picture of the table.
    pub(super) pictures: Vec<Vec<u8>>,
    pub(super) others: Others,
}

/// The rows of one episode.
pub(super) struct Rows<'a> {
    path: PathBuf,
    features: &'a Features,
    reader: ParquetRecordBatchReader,
    batch: Option<RecordBatch>,
    /// Rows of the batch that were returned.
    done: usize,
    episode: u64,
    /// Rows of the episode that were returned.
    step: u64,
}

impl<'a> Rows<'a> {
    pub(super) fn open(table: &Table, place: &Place, features: &'a Features) -> Result<Self, Problem> {
        let names = features.stored().map(|picture| &picture.feature);
        let names = names.chain(features.state.iter().chain(&features.action).map(|(name, _)| name));
        let names: Vec<&str> = names.chain(&features.others).map(String::as_str).collect();
        let rows = table.part(&names, place.first_row, place.steps)?;
        let (path, episode) = (table.path.clone(), place.episode);
        let reader = rows.with_batch_size(ROWS).build().map_err(|error| damaged(&path, &error))?;
        Ok(Self { path, features, reader, batch: None, done: 0, episode, step: 0 })
    }

    /// The next row.
    pub(super) fn next(&mut self) -> Result<Option<Row>, Problem> {
        loop {
            if let Some(batch) = self.batch.as_ref().filter(|batch| self.done < batch.num_rows()) {
                let row = self.row(batch, self.done)?;
                self.done += 1;
                self.step += 1;
                return Ok(Some(row));
            }
            match self.reader.next().transpose().map_err(|error| damaged(&self.path, &error))? {
                Some(batch) => (self.batch, self.done) = (Some(batch), 0),
                None => return Ok(None),
            }
        }
    }

    fn row(&self, batch: &RecordBatch, row: usize) -> Result<Row, Problem> {
        let wrong = |name: &str, problem: &str| {
            unfit(&self.path, &format!("{name}, step {} of episode {}: {problem}", self.step, self.episode))
        };
        let column = |name: &str| batch.column_by_name(name).ok_or_else(|| wrong(name, "the column is missing"));
        let vector = |features: &[(String, usize)]| {
            let mut values = Vec::new();
            for (name, size) in features {
                let before = values.len();
                let read = cells::numbers(column(name)?.as_ref(), row, &mut values);
                if read.is_none() || values.len() - before != *size {
                    let found = values.len() - before;
                    let problem = format!("{found} numbers, and meta/info.json declares {size}; correct its shape");
                    return Err(wrong(name, &problem));
                }
            }
            Ok(values)
        };
        let mut pictures = Vec::new();
        for picture in self.features.stored() {
            let bytes = cells::picture(column(&picture.feature)?.as_ref(), row);
            let absent = "the picture's bytes are not in the table; save the dataset with embedded images";
            pictures.push(bytes.ok_or_else(|| wrong(&picture.feature, absent))?.to_vec());
        }
        let mut others = Others::new();
        for name in self.features.others.iter().chain(&self.features.wide) {
            others.insert(name.clone(), cells::json(column(name)?.as_ref(), row));
        }
        let (state, action) = (vector(&self.features.state)?, vector(&self.features.action)?);
        Ok(Row { state, action, pictures, others })
    }
}
