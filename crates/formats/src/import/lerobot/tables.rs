//! Parquet files: where they are, their columns, and the rows in which a column has one of some numbers.
//!
//! A search skips row groups whose statistics exclude the numbers, because each run of episodes is a search in tables of all
//! episodes.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use arrow_array::RecordBatch;
use bytes::Bytes;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder};
use parquet::file::metadata::{ParquetStatisticsPolicy, RowGroupMetaData};
use parquet::file::reader::{ChunkReader, Length};
use parquet::file::statistics::Statistics;
use serde_json::Value;

use super::{cells, unfit, unopened};
use crate::problem::Problem;

/// Rows that are decoded at once where a row has numbers and texts alone.
const TABLE_ROWS: usize = 1024;

/// A row of a small table: its cells by their columns.
pub(super) type Cells = BTreeMap<String, Value>;

/// A column with some of its numbers.
pub(super) type Wanted<'a> = (&'a str, &'a RangeInclusive<i64>);

/// A reader of some columns.
pub(super) type Builder = ParquetRecordBatchReaderBuilder<Bounded>;

/// A file of parquet, whose end is an error: the reader skips what a damaged page states, be it billions of values, and does
/// not notice that none is left.
pub(super) struct Bounded(File);

impl Length for Bounded {
    fn len(&self) -> u64 {
        Length::len(&self.0)
    }
}

impl ChunkReader for Bounded {
    type T = Part;

    fn get_read(&self, start: u64) -> parquet::errors::Result<Part> {
        self.0.get_read(start).map(Part)
    }

    fn get_bytes(&self, start: u64, length: usize) -> parquet::errors::Result<Bytes> {
        self.0.get_bytes(start, length)
    }
}

/// A file from some byte on.
pub(super) struct Part(BufReader<File>);

impl Read for Part {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let count = self.0.read(out)?;
        if count == 0 && !out.is_empty() { Err(ErrorKind::UnexpectedEof.into()) } else { Ok(count) }
    }
}

/// The files `*.parquet` in a folder or the folders in it, by their names.
pub(super) fn tables(folder: &Path) -> Result<Vec<PathBuf>, Problem> {
    let list = |folder: &Path| -> Result<Vec<PathBuf>, Problem> {
        let entries = std::fs::read_dir(folder).map_err(unopened(folder))?;
        let mut paths = Vec::new();
        for entry in entries {
            paths.push(entry.map_err(Problem::io(folder))?.path());
        }
        paths.sort();
        Ok(paths)
    };
    let mut found = Vec::new();
    for path in list(folder)? {
        let inside = if path.is_dir() { list(&path)? } else { vec![path] };
        found.extend(inside.into_iter().filter(|path| path.extension().is_some_and(|ending| ending == "parquet")));
    }
    Ok(found)
}

/// A file of parquet whose footer is read.
pub(super) struct Table {
    pub(super) path: PathBuf,
    metadata: ArrowReaderMetadata,
    /// The row at which each row group begins, and the number of all rows.
    begins: Vec<u64>,
}

impl Table {
    pub(super) fn open(path: &Path) -> Result<Self, Problem> {
        let file = Bounded(File::open(path).map_err(unopened(path))?);
        let options = ArrowReaderOptions::new()
            // The types are those of parquet, whatever a writer noted beside them.
            .with_skip_arrow_metadata(true)
            // A footer has one of each for every column of every row group.
            .with_encoding_stats_policy(ParquetStatisticsPolicy::SkipAll)
            .with_size_stats_policy(ParquetStatisticsPolicy::SkipAll);
        let metadata = ArrowReaderMetadata::load(&file, options).map_err(|error| damaged(path, &error))?;
        let mut begins = vec![0];
        begins.extend(metadata.metadata().row_groups().iter().scan(0, |end: &mut u64, group| {
            *end = end.saturating_add(length(group));
            Some(*end)
        }));
        Ok(Self { path: path.to_owned(), metadata, begins })
    }

    /// Number of rows.
    pub(super) fn length(&self) -> u64 {
        self.begins.last().copied().unwrap_or_default()
    }

    /// The rows of a small table, of the columns named: all, or those in which a column has one of some numbers. A column
    /// that is not there is absent in the rows.
    pub(super) fn rows(&self, columns: &[String], wanted: Option<Wanted<'_>>) -> Result<Vec<Cells>, Problem> {
        let names: Vec<&str> = columns.iter().map(String::as_str).collect();
        let mut reader = self.columns(&names)?;
        if let Some(wanted) = wanted {
            reader = reader.with_row_groups(self.groups_with(wanted));
        }
        let mut rows = Vec::new();
        for batch in reader.with_batch_size(TABLE_ROWS).build().map_err(|error| damaged(&self.path, &error))? {
            let batch = batch.map_err(|error| damaged(&self.path, &error))?;
            let schema = batch.schema();
            for row in
                (0..batch.num_rows()).filter(|row| wanted.is_none_or(|wanted| number(&batch, *row, wanted).is_some()))
            {
                let cells = schema.fields().iter().zip(batch.columns());
                rows.push(
                    cells.map(|(field, column)| (field.name().clone(), cells::json(column.as_ref(), row))).collect(),
                );
            }
        }
        Ok(rows)
    }

    /// For each of some numbers the first row in which a column has it.
    pub(super) fn first_rows(&self, wanted: Wanted<'_>) -> Result<BTreeMap<i64, u64>, Problem> {
        let groups = self.groups_with(wanted);
        let rows_of = |at: &usize| self.begins.get(*at).zip(self.begins.get(at + 1)).map(|(begin, end)| *begin..*end);
        let mut places = groups.iter().filter_map(rows_of).flatten();
        let reader = self.columns(&[wanted.0])?.with_row_groups(groups.clone()).with_batch_size(TABLE_ROWS);
        let mut found = BTreeMap::new();
        for batch in reader.build().map_err(|error| damaged(&self.path, &error))? {
            let batch = batch.map_err(|error| damaged(&self.path, &error))?;
            for (row, place) in (0..batch.num_rows()).zip(&mut places) {
                if let Some(number) = number(&batch, row, wanted) {
                    found.entry(number).or_insert(place);
                }
            }
        }
        Ok(found)
    }

    /// A reader of some rows, of the columns named.
    pub(super) fn part(&self, names: &[&str], first: u64, rows: u64) -> Result<Builder, Problem> {
        let end = first.saturating_add(rows);
        // The last entry is no row group, but the end of all.
        let groups = self.begins.len().saturating_sub(1);
        let from = self.begins.partition_point(|begin| *begin <= first).saturating_sub(1);
        let to = self.begins.partition_point(|begin| *begin < end).min(groups);
        let skipped = self.begins.get(from).copied().unwrap_or_default();
        let size = |rows: u64| usize::try_from(rows).unwrap_or(usize::MAX);
        let reader = self.columns(names)?.with_row_groups((from..to).collect());
        Ok(reader.with_offset(size(first.saturating_sub(skipped))).with_limit(size(rows)))
    }

    /// A reader of the columns named.
    fn columns(&self, names: &[&str]) -> Result<Builder, Problem> {
        let file = Bounded(File::open(&self.path).map_err(unopened(&self.path))?);
        let builder = Builder::new_with_metadata(file, self.metadata.clone());
        // Names have dots, which a path of columns would split.
        let fields = builder.schema().fields().iter().enumerate();
        let roots: Vec<usize> =
            fields.filter(|(_, field)| names.contains(&field.name().as_str())).map(|(at, _)| at).collect();
        let mask = ProjectionMask::roots(builder.parquet_schema(), roots);
        Ok(builder.with_projection(mask))
    }

    /// The row groups in which a column may have one of some numbers: all if they have no statistics.
    fn groups_with(&self, (column, numbers): Wanted<'_>) -> Vec<usize> {
        let leaves = self.metadata.parquet_schema().columns().iter();
        let leaf = leaves.map(|leaf| leaf.path().parts()).position(|parts| parts == [column]);
        let statistics = |group: &RowGroupMetaData| group.columns().get(leaf?)?.statistics().and_then(bounds);
        let meet = |(low, high): (i64, i64)| low > high || (low <= *numbers.end() && high >= *numbers.start());
        let groups = self.metadata.metadata().row_groups().iter().enumerate();
        groups.filter(|(_, group)| statistics(group).is_none_or(meet)).map(|(at, _)| at).collect()
    }
}

/// The number of rows that a row group states.
fn length(group: &RowGroupMetaData) -> u64 {
    u64::try_from(group.num_rows()).unwrap_or_default()
}

/// The smallest and the largest value of a column with whole numbers.
fn bounds(statistics: &Statistics) -> Option<(i64, i64)> {
    match statistics {
        Statistics::Int32(values) => Some(((*values.min_opt()?).into(), (*values.max_opt()?).into())),
        Statistics::Int64(values) => Some((*values.min_opt()?, *values.max_opt()?)),
        Statistics::Boolean(_)
        | Statistics::Int96(_)
        | Statistics::Float(_)
        | Statistics::Double(_)
        | Statistics::ByteArray(_)
        | Statistics::FixedLenByteArray(_) => None,
    }
}

/// The number that a row has in a column, if it is one of those wanted.
fn number(batch: &RecordBatch, row: usize, (column, numbers): Wanted<'_>) -> Option<i64> {
    let number = cells::json(batch.column_by_name(column)?.as_ref(), row).as_i64();
    number.filter(|number| numbers.contains(number))
}

/// The error of a table that cannot be read.
pub(super) fn damaged(path: &Path, error: &dyn std::fmt::Display) -> Problem {
    unfit(path, &format!("the table is damaged or cut ({error}); copy or download it again"))
}
