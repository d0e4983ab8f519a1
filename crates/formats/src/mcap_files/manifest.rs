//! The manifest of the files: the same rows as JSON lines and as one Parquet table.

use std::fs::File;
use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use arrow_array::builder::{
    ArrayBuilder, Float32Builder, Float64Builder, ListBuilder, StringBuilder, StructBuilder, UInt32Builder,
    UInt64Builder,
};
use arrow_array::{RecordBatch, StringArray, UInt32Array, UInt64Array};
use arrow_schema::{ArrowError, DataType, Field, Fields, Schema};
use gleaner_core::snapshot::Role;
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::properties::WriterProperties;
use serde::Serialize;

use crate::export::Export;
use crate::problem::Problem;

const LINES: &str = "manifest.jsonl";
const TABLE: &str = "manifest.parquet";

/// One file of the export. Step numbers are those of the original episode.
#[derive(Serialize)]
pub(super) struct Line<'a> {
    pub(super) episode: &'a str,
    pub(super) source: &'a str,
    pub(super) file: &'a str,
    pub(super) role: Role,
    pub(super) first_step: u64,
    pub(super) last_step: u64,
    /// l: the segment that ends at a step begins l steps before it.
    pub(super) segment_length: u32,
    /// The kept steps; empty for experts, whose steps all have weight 1.
    pub(super) steps: Vec<Step<'a>>,
}

/// One kept step: the end of a kept segment.
#[derive(Serialize)]
pub(super) struct Step<'a> {
    pub(super) step: u64,
    pub(super) q: f32,
    pub(super) w: f64,
    /// `None` when the scorer has no matches.
    pub(super) nearest_episode: Option<&'a str>,
    pub(super) nearest_step: Option<u32>,
}

/// A manifest that is being written.
pub(super) struct Manifest {
    lines: Vec<u8>,
    table: ArrowWriter<File>,
    path: PathBuf,
}

impl Manifest {
    pub(super) fn create<E: Export>(export: &E) -> Result<Self, Problem> {
        let path = export.folder().join(TABLE);
        let file = File::create(&path).map_err(Problem::io(&path))?;
        let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
        let table = ArrowWriter::try_new(file, Arc::new(schema()), Some(properties));
        Ok(Self { lines: Vec::new(), table: table.map_err(Problem::encoding(&path))?, path })
    }

    pub(super) fn push(&mut self, line: &Line<'_>) -> Result<(), Problem> {
        let appended = serde_json::to_writer(&mut self.lines, line).map_err(Into::into);
        appended.and_then(|()| self.lines.write_all(b"\n")).map_err(Problem::io(LINES.as_ref()))?;
        let row = row(line).map_err(Problem::encoding(&self.path))?;
        self.table.write(&row).map_err(Problem::encoding(&self.path))
    }

    pub(super) fn finish<E: Export>(self, export: &mut E) -> Result<(), E::Error> {
        let path = export.folder().join(LINES);
        std::fs::write(&path, &self.lines).map_err(Problem::io(&path))?;
        export.finished(LINES)?;
        self.table.close().map_err(Problem::encoding(&self.path))?;
        export.finished(TABLE)
    }
}

fn step_fields() -> Fields {
    Fields::from(vec![
        Field::new("step", DataType::UInt64, false),
        Field::new("q", DataType::Float32, false),
        Field::new("w", DataType::Float64, false),
        Field::new("nearest_episode", DataType::Utf8, true),
        Field::new("nearest_step", DataType::UInt32, true),
    ])
}

fn schema() -> Schema {
    let item = Arc::new(Field::new("item", DataType::Struct(step_fields()), true));
    Schema::new(vec![
        Field::new("episode", DataType::Utf8, false),
        Field::new("source", DataType::Utf8, false),
        Field::new("file", DataType::Utf8, false),
        Field::new("role", DataType::Utf8, false),
        Field::new("first_step", DataType::UInt64, false),
        Field::new("last_step", DataType::UInt64, false),
        Field::new("segment_length", DataType::UInt32, false),
        Field::new("steps", DataType::List(item), false),
    ])
}

/// A table of one row, in the order of [`schema`].
fn row(line: &Line<'_>) -> Result<RecordBatch, ArrowError> {
    let Line { episode, source, file, role, first_step, last_step, segment_length, steps } = line;
    let text = |text: &str| Arc::new(StringArray::from(vec![text]));
    let whole = |whole: u64| Arc::new(UInt64Array::from(vec![whole]));
    RecordBatch::try_new(
        Arc::new(schema()),
        vec![
            text(episode),
            text(source),
            text(file),
            text(role.as_str()),
            whole(*first_step),
            whole(*last_step),
            Arc::new(UInt32Array::from(vec![*segment_length])),
            Arc::new(list(steps)?),
        ],
    )
}

/// One list of steps.
fn list(steps: &[Step<'_>]) -> Result<arrow_array::ListArray, ArrowError> {
    let (mut number, mut q, mut w) = (UInt64Builder::new(), Float32Builder::new(), Float64Builder::new());
    let (mut nearest_episode, mut nearest_step) = (StringBuilder::new(), UInt32Builder::new());
    for step in steps {
        number.append_value(step.step);
        q.append_value(step.q);
        w.append_value(step.w);
        nearest_episode.append_option(step.nearest_episode);
        nearest_step.append_option(step.nearest_step);
    }
    let columns: Vec<Box<dyn ArrayBuilder>> =
        vec![Box::new(number), Box::new(q), Box::new(w), Box::new(nearest_episode), Box::new(nearest_step)];
    let mut list = ListBuilder::new(StructBuilder::new(step_fields(), columns));
    steps.iter().for_each(|_| list.values().append(true));
    list.append(true);
    Ok(list.finish())
}

#[cfg(test)]
mod tests {
    use arrow_array::cast::AsArray as _;
    use gleaner_core::dataset::{ExportFormat, ExportSpec};
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
    use serde_json::{Value, json};

    use super::*;
    use crate::testing::Lab;

    fn read(json: &str) -> Value {
        serde_json::from_str(json).unwrap()
    }

    /// Every row of a table as the JSON line that it should be.
    fn rows(table: &RecordBatch) -> Vec<Value> {
        use arrow_array::types::{Float32Type, Float64Type, UInt32Type, UInt64Type};
        let text = |name: &str, at: usize| table.column_by_name(name).unwrap().as_string::<i32>().value(at).to_owned();
        let whole = |name: &str, at: usize| table.column_by_name(name).unwrap().as_primitive::<UInt64Type>().value(at);
        let steps = |at: usize| {
            let steps = table.column_by_name("steps").unwrap().as_list::<i32>().value(at);
            let steps = steps.as_struct().clone();
            let column = |name: &str| Arc::clone(steps.column_by_name(name).unwrap());
            let step = |at: usize| {
                let (episode, step) = (column("nearest_episode"), column("nearest_step"));
                json!({
                    "step": column("step").as_primitive::<UInt64Type>().value(at),
                    // As the line has it: the shortest digits of a 32-bit number.
                    "q": read(&column("q").as_primitive::<Float32Type>().value(at).to_string()),
                    "w": column("w").as_primitive::<Float64Type>().value(at),
                    "nearest_episode": episode.is_valid(at).then(|| episode.as_string::<i32>().value(at).to_owned()),
                    "nearest_step": step.is_valid(at).then(|| step.as_primitive::<UInt32Type>().value(at)),
                })
            };
            (0..arrow_array::Array::len(&steps)).map(step).collect::<Vec<_>>()
        };
        let row = |at: usize| {
            json!({
                "episode": text("episode", at), "source": text("source", at), "file": text("file", at),
                "role": text("role", at), "first_step": whole("first_step", at), "last_step": whole("last_step", at),
                "segment_length": table.column_by_name("segment_length").unwrap().as_primitive::<UInt32Type>().value(at),
                "steps": steps(at),
            })
        };
        (0..table.num_rows()).map(row).collect()
    }

    #[test]
    fn the_table_has_the_rows_of_the_lines() {
        let mut lab = Lab::new();
        crate::write(ExportSpec { format: ExportFormat::Mcap, ..ExportSpec::default() }, &mut lab).unwrap();
        let lines = String::from_utf8(lab.read(LINES)).unwrap();
        let lines: Vec<Value> = lines.lines().map(read).collect();
        let file = File::open(lab.out.path().join(TABLE)).unwrap();
        let tables = ParquetRecordBatchReaderBuilder::try_new(file).unwrap().build().unwrap();
        let found: Vec<Value> = tables.flat_map(|table| rows(&table.unwrap())).collect();
        assert_eq!(found, lines);
        assert_eq!(lines[2]["steps"].as_array().unwrap().len(), 3);
        assert_eq!(lines[2]["steps"][0]["nearest_step"], 3);
        let mut again = Lab::new();
        crate::write(ExportSpec { format: ExportFormat::Mcap, ..ExportSpec::default() }, &mut again).unwrap();
        assert!(lab.read(TABLE) == again.read(TABLE), "the same dataset is the same bytes");
    }
}
