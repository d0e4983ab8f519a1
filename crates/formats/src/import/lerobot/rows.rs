//! Rows of a data file, some at a time.

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

/// Rows of a data file, one after the other.
pub(super) struct Rows {
    path: PathBuf,
    reader: ParquetRecordBatchReader,
    batch: Option<RecordBatch>,
    /// Rows of the batch that were returned.
    done: usize,
    /// The row of the file that is returned next.
    pub(super) at: u64,
    /// The row of the file before which they end.
    pub(super) end: u64,
}

impl Rows {
    /// Begins at a row of the file; `rows`: the most that are read.
    pub(super) fn open(table: &Table, features: &Features, first: u64, rows: u64) -> Result<Self, Problem> {
        let names = features.stored().map(|picture| &picture.feature);
        let names = names.chain(features.state.iter().chain(&features.action).map(|(name, _)| name));
        let names: Vec<&str> = names.chain(&features.others).map(String::as_str).collect();
        let reader = table.part(&names, first, rows)?.with_batch_size(ROWS).build();
        let reader = reader.map_err(|error| damaged(&table.path, &error))?;
        let (path, end) = (table.path.clone(), first.saturating_add(rows));
        Ok(Self { path, reader, batch: None, done: 0, at: first, end })
    }

    /// The next row, which is this step of the episode.
    pub(super) fn next(&mut self, features: &Features, place: &Place, step: u64) -> Result<Option<Row>, Problem> {
        loop {
            if let Some(batch) = self.batch.as_ref().filter(|batch| self.done < batch.num_rows()) {
                let row = self.row(features, batch, (place.episode, step))?;
                self.done += 1;
                self.at = self.at.saturating_add(1);
                return Ok(Some(row));
            }
            match self.reader.next().transpose().map_err(|error| damaged(&self.path, &error))? {
                Some(batch) => (self.batch, self.done) = (Some(batch), 0),
                None => return Ok(None),
            }
        }
    }

    fn row(&self, features: &Features, batch: &RecordBatch, (episode, step): (u64, u64)) -> Result<Row, Problem> {
        let row = self.done;
        let wrong = |name: &str, problem: &str| {
            unfit(&self.path, &format!("{name}, step {step} of episode {episode}: {problem}"))
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
        for picture in features.stored() {
            let bytes = cells::picture(column(&picture.feature)?.as_ref(), row);
            let absent = "the picture's bytes are not in the table; save the dataset with embedded images";
            pictures.push(bytes.ok_or_else(|| wrong(&picture.feature, absent))?.to_vec());
        }
        let mut others = Others::new();
        for name in features.others.iter().chain(&features.wide) {
            others.insert(name.clone(), cells::json(column(name)?.as_ref(), row));
        }
        let (state, action) = (vector(&features.state)?, vector(&features.action)?);
        Ok(Row { state, action, pictures, others })
    }
}
