//! Parquet files: where they are, their columns, and small tables whole.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read};
use std::path::{Path, PathBuf};

use bytes::Bytes;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{ArrowReaderOptions, ParquetRecordBatchReaderBuilder};
use parquet::file::reader::{ChunkReader, Length};
use serde_json::Value;

use super::{cells, unfit, unopened};
use crate::problem::Problem;

/// Rows of small tables that are decoded at once.
const TABLE_ROWS: usize = 1024;

/// A file of parquet, whose end is an error: the reader skips what a damaged page states, be it billions of values, and does
/// not notice that none is left.
pub(super) struct Table(File);

impl Length for Table {
    fn len(&self) -> u64 {
        Length::len(&self.0)
    }
}

impl ChunkReader for Table {
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

/// All rows of a small table, of the columns named; a column that is not there is absent in the rows.
pub(super) fn read_table(path: &Path, columns: &[String]) -> Result<Vec<BTreeMap<String, Value>>, Problem> {
    let names: Vec<&str> = columns.iter().map(String::as_str).collect();
    let reader = builder(path, &names)?.with_batch_size(TABLE_ROWS).build().map_err(|error| damaged(path, &error))?;
    let mut rows = Vec::new();
    for batch in reader {
        let batch = batch.map_err(|error| damaged(path, &error))?;
        let schema = batch.schema();
        for row in 0..batch.num_rows() {
            let cells = schema.fields().iter().zip(batch.columns());
            rows.push(cells.map(|(field, column)| (field.name().clone(), cells::json(column.as_ref(), row))).collect());
        }
    }
    Ok(rows)
}

/// A reader of the columns named.
pub(super) fn builder(path: &Path, names: &[&str]) -> Result<ParquetRecordBatchReaderBuilder<Table>, Problem> {
    let file = Table(File::open(path).map_err(unopened(path))?);
    // The types are those of parquet, whatever a writer noted beside them.
    let options = ArrowReaderOptions::new().with_skip_arrow_metadata(true);
    let builder = ParquetRecordBatchReaderBuilder::try_new_with_options(file, options);
    let builder = builder.map_err(|error| damaged(path, &error))?;
    // Names have dots, which a path of columns would split.
    let fields = builder.schema().fields().iter().enumerate();
    let roots: Vec<usize> =
        fields.filter(|(_, field)| names.contains(&field.name().as_str())).map(|(at, _)| at).collect();
    let mask = ProjectionMask::roots(builder.parquet_schema(), roots);
    Ok(builder.with_projection(mask))
}

/// The error of a table that cannot be read.
pub(super) fn damaged(path: &Path, error: &dyn std::fmt::Display) -> Problem {
    unfit(path, &format!("the table is damaged or cut ({error}); copy or download it again"))
}
