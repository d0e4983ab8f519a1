//! The data files: one row a frame, one row group an episode, so that an episode can be read alone.

use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;

use arrow_array::builder::{BinaryBuilder, FixedSizeListBuilder, Float32Builder, StringBuilder};
use arrow_array::{ArrayRef, BooleanArray, Float32Array, Int64Array, RecordBatch, StructArray};
use arrow_schema::{DataType, Field, Fields, Schema};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::properties::{EnabledStatistics, WriterProperties};

use super::Begun;
use super::features::{COLUMNS, Features};
use crate::problem::Problem;

/// Rows that are encoded at once.
const ROWS: usize = 256;
/// An episode with more encoded bytes than this has several row groups.
const ROW_GROUP_BYTES: usize = 64 << 20;
/// Bytes of rows that wait for their encoding.
const WAITING_BYTES: usize = 16 << 20;

/// One frame.
#[derive(Clone, Debug)]
pub(super) struct FrameRow {
    pub(super) state: Vec<f32>,
    pub(super) action: Vec<f32>,
    pub(super) done: bool,
    pub(super) success: bool,
    pub(super) q: f32,
    pub(super) w: f32,
    pub(super) weight: f32,
    pub(super) match_episode: i64,
    pub(super) match_step: i64,
    pub(super) step: i64,
    pub(super) timestamp: f32,
    pub(super) frame_index: i64,
    pub(super) episode_index: i64,
    pub(super) index: i64,
    /// A file for each camera whose pictures are in the table.
    pub(super) images: Vec<Vec<u8>>,
    /// The frames of the step, if they were read.
    pub(super) pixels: Option<Vec<u8>>,
    /// Whether its pictures count for statistics.
    pub(super) sampled: bool,
}

impl FrameRow {
    /// Its value of a column.
    fn column(&self, name: &str) -> Value {
        match name {
            "next.done" => Value::Flag(self.done),
            "next.success" => Value::Flag(self.success),
            "gleaner.q" => Value::Real(self.q),
            "gleaner.w" => Value::Real(self.w),
            "gleaner.weight" => Value::Real(self.weight),
            "gleaner.match_episode" => Value::Whole(self.match_episode),
            "gleaner.match_step" => Value::Whole(self.match_step),
            "gleaner.step" => Value::Whole(self.step),
            "timestamp" => Value::Real(self.timestamp),
            "frame_index" => Value::Whole(self.frame_index),
            "episode_index" => Value::Whole(self.episode_index),
            "index" => Value::Whole(self.index),
            // Every dataset has one task.
            _ => Value::Whole(0),
        }
    }

    fn vector(&self, name: &str) -> &[f32] {
        if name == "action" { &self.action } else { &self.state }
    }

    /// The numbers of each feature, in the order of statistics.
    pub(super) fn numbers(&self, features: &Features) -> Vec<Vec<f64>> {
        let vectors = features.vectors().iter();
        let vectors = vectors.map(|vector| self.vector(vector.name).iter().copied().map(f64::from).collect());
        vectors.chain(COLUMNS.iter().map(|(name, _)| vec![self.column(name).number()])).collect()
    }

    fn bytes(&self) -> usize {
        let numbers = 4 * (self.state.len() + self.action.len()) + 8 * COLUMNS.len();
        numbers + self.images.iter().map(Vec::len).sum::<usize>()
    }
}

/// A value of a column.
#[derive(Clone, Copy, Debug)]
enum Value {
    Flag(bool),
    Real(f32),
    Whole(i64),
}

impl Value {
    #[expect(clippy::cast_precision_loss, reason = "indices are far below 2^53")]
    fn number(self) -> f64 {
        match self {
            Self::Flag(flag) => f64::from(u8::from(flag)),
            Self::Real(real) => real.into(),
            Self::Whole(whole) => whole as f64,
        }
    }
}

/// A data file that is being written.
pub(super) struct Frames {
    writer: ArrowWriter<File>,
    path: PathBuf,
    features: Features,
    waiting: Vec<FrameRow>,
    waiting_bytes: usize,
}

impl Frames {
    pub(super) fn create(begun: Begun, features: &Features) -> Result<Self, Problem> {
        let Begun { file, path } = begun;
        // Statistics of pictures' bytes are of no use, and equal pictures are rare.
        let properties = WriterProperties::builder().set_compression(Compression::SNAPPY);
        let properties = features.stored().fold(properties, |properties, camera| {
            let column = parquet::schema::types::ColumnPath::new(vec![camera.name.clone(), "bytes".to_owned()]);
            properties
                .set_column_dictionary_enabled(column.clone(), false)
                .set_column_statistics_enabled(column, EnabledStatistics::None)
        });
        let writer = ArrowWriter::try_new(file, Arc::new(schema(features)), Some(properties.build()));
        let writer = writer.map_err(Problem::encoding(&path))?;
        Ok(Self { writer, path, features: features.clone(), waiting: Vec::new(), waiting_bytes: 0 })
    }

    /// Bytes of the file so far.
    pub(super) fn bytes(&self) -> u64 {
        u64::try_from(self.writer.bytes_written()).unwrap_or(u64::MAX)
    }

    pub(super) fn push(&mut self, row: FrameRow) -> Result<(), Problem> {
        self.waiting_bytes += row.bytes();
        self.waiting.push(FrameRow { pixels: None, ..row });
        if self.waiting.len() >= ROWS || self.waiting_bytes >= WAITING_BYTES { self.encode() } else { Ok(()) }
    }

    pub(super) fn end_episode(&mut self) -> Result<(), Problem> {
        self.encode()?;
        self.writer.flush().map_err(Problem::encoding(&self.path))
    }

    pub(super) fn finish(self) -> Result<(), Problem> {
        let closed = self.writer.close().map(|_| ());
        closed.map_err(Problem::encoding(&self.path))
    }

    fn encode(&mut self) -> Result<(), Problem> {
        let rows = std::mem::take(&mut self.waiting);
        self.waiting_bytes = 0;
        if rows.is_empty() {
            return Ok(());
        }
        let batch = batch(&self.features, &rows).map_err(Problem::encoding(&self.path))?;
        self.writer.write(&batch).map_err(Problem::encoding(&self.path))?;
        if self.writer.in_progress_size() >= ROW_GROUP_BYTES {
            self.writer.flush().map_err(Problem::encoding(&self.path))?;
        }
        Ok(())
    }
}

fn item() -> Arc<Field> {
    Arc::new(Field::new("element", DataType::Float32, true))
}

fn picture() -> Fields {
    Fields::from(vec![Field::new("bytes", DataType::Binary, true), Field::new("path", DataType::Utf8, true)])
}

fn schema(features: &Features) -> Schema {
    let vectors = features.vectors().iter().map(|vector| match i32::try_from(vector.size) {
        Ok(size) if size > 1 => Field::new(vector.name, DataType::FixedSizeList(item(), size), true),
        // A feature of shape [1] is the number itself.
        Ok(_) | Err(_) => Field::new(vector.name, DataType::Float32, true),
    });
    let cameras = features.stored().map(|camera| Field::new(&camera.name, DataType::Struct(picture()), true));
    let columns = COLUMNS.iter().map(|(name, dtype)| {
        let kind = match *dtype {
            "bool" => DataType::Boolean,
            "float32" => DataType::Float32,
            _ => DataType::Int64,
        };
        Field::new(*name, kind, true)
    });
    Schema::new(vectors.chain(cameras).chain(columns).collect::<Vec<_>>())
}

fn batch(features: &Features, rows: &[FrameRow]) -> Result<RecordBatch, arrow_schema::ArrowError> {
    let mut arrays: Vec<ArrayRef> = Vec::new();
    for vector in features.vectors() {
        let values = rows.iter().map(|row| row.vector(vector.name));
        arrays.push(match i32::try_from(vector.size) {
            Ok(size) if size > 1 => {
                let mut list = FixedSizeListBuilder::new(Float32Builder::new(), size).with_field(item());
                for values in values {
                    list.values().append_slice(values);
                    list.append(true);
                }
                Arc::new(list.finish())
            }
            Ok(_) | Err(_) => Arc::new(values.flatten().copied().collect::<Float32Array>()),
        });
    }
    for at in 0..features.stored().count() {
        let (mut bytes, mut path) = (BinaryBuilder::new(), StringBuilder::new());
        for row in rows {
            bytes.append_option(row.images.get(at));
            path.append_null();
        }
        let columns: Vec<ArrayRef> = vec![Arc::new(bytes.finish()), Arc::new(path.finish())];
        arrays.push(Arc::new(StructArray::try_new(picture(), columns, None)?));
    }
    for (name, dtype) in COLUMNS {
        let values = rows.iter().map(|row| row.column(name));
        arrays.push(match dtype {
            "bool" => {
                Arc::new(values.map(|value| matches!(value, Value::Flag(true))).map(Some).collect::<BooleanArray>())
            }
            "float32" => {
                let real = |value| if let Value::Real(real) = value { real } else { 0.0 };
                Arc::new(values.map(real).collect::<Float32Array>())
            }
            _ => {
                let whole = |value| if let Value::Whole(whole) = value { whole } else { 0 };
                Arc::new(values.map(whole).collect::<Int64Array>())
            }
        });
    }
    RecordBatch::try_new(Arc::new(schema(features)), arrays)
}
