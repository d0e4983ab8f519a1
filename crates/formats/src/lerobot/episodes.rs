//! The table of episodes: where each is, where it comes from, and its statistics.

use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;

use arrow_array::builder::{Float64Builder, Int64Builder, ListBuilder, StringBuilder};
use arrow_array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::properties::WriterProperties;

use super::features::Features;
use super::films::Place;
use super::stats::{NAMES, Stats};
use super::{Begun, FileNumber, number};
use crate::piece::Piece;
use crate::problem::Problem;

/// Episodes that are encoded at once.
const ROWS: usize = 256;

/// An episode.
pub(super) struct Episode<'a> {
    pub(super) piece: &'a Piece,
    pub(super) index: usize,
    /// The frame after its last one.
    pub(super) end: usize,
    pub(super) task: &'a str,
    /// The file of its frames.
    pub(super) file: FileNumber,
    /// Where the pictures of each camera with a video are.
    pub(super) videos: &'a [Place],
    pub(super) stats: &'a Stats,
}

/// The table that is being written.
pub(super) struct Episodes {
    writer: ArrowWriter<File>,
    path: PathBuf,
    columns: Vec<Column>,
    rows: usize,
}

/// One column, with the values that wait for their encoding.
enum Column {
    Whole(String, Vec<i64>),
    Real(String, Vec<f64>),
    Text(String, Vec<String>),
    /// A list with one text a row.
    Texts(String, Vec<String>),
    /// A list with the count of a feature's frames.
    Count(String, Vec<i64>),
    /// A list of numbers a row.
    Numbers(String, Vec<Vec<f64>>),
    /// Channels × 1 × 1 numbers a row.
    Channels(String, Vec<Vec<f64>>),
}

const WHOLE: [&str; 9] = [
    "episode_index",
    "length",
    "data/chunk_index",
    "data/file_index",
    "dataset_from_index",
    "dataset_to_index",
    "meta/episodes/chunk_index",
    "meta/episodes/file_index",
    "gleaner.first_step",
];
const TEXT: [&str; 5] = ["gleaner.episode", "gleaner.source", "gleaner.role", "gleaner.outcome", "gleaner.cohort"];

impl Episodes {
    pub(super) fn create(begun: Begun, features: &Features) -> Result<Self, Problem> {
        let Begun { file, path } = begun;
        let mut columns: Vec<Column> = vec![Column::Texts("tasks".to_owned(), Vec::new())];
        columns.extend(WHOLE.iter().map(|name| Column::Whole((*name).to_owned(), Vec::new())));
        for camera in features.cameras().iter().filter(|camera| camera.film) {
            let name = |what: &str| format!("videos/{}/{what}", camera.name);
            columns.extend(["chunk_index", "file_index"].map(|what| Column::Whole(name(what), Vec::new())));
            columns.extend(["from_timestamp", "to_timestamp"].map(|what| Column::Real(name(what), Vec::new())));
        }
        columns.extend(TEXT.iter().map(|name| Column::Text((*name).to_owned(), Vec::new())));
        for (feature, _, image) in Stats::new(features).summaries() {
            for stat in NAMES {
                let name = format!("stats/{feature}/{stat}");
                let column = if image { Column::Channels } else { Column::Numbers };
                columns.push(column(name, Vec::new()));
            }
            columns.push(Column::Count(format!("stats/{feature}/count"), Vec::new()));
        }
        let schema = Schema::new(columns.iter().map(Column::field).collect::<Vec<_>>());
        let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
        let writer =
            ArrowWriter::try_new(file, Arc::new(schema), Some(properties)).map_err(Problem::encoding(&path))?;
        Ok(Self { writer, path, columns, rows: 0 })
    }

    pub(super) fn push(&mut self, episode: &Episode<'_>) -> Result<(), Problem> {
        let Episode { piece, index, end, task, file, videos, stats } = episode;
        let input = piece.episode();
        let whole = [
            number(*index),
            number(piece.len()),
            number(file.chunk()),
            number(file.file()),
            number(end.saturating_sub(piece.len())),
            number(*end),
            0,
            0,
            number(piece.steps.start),
        ];
        let text = [input.id.as_str(), &input.file_name, piece.role().as_str(), input.outcome.as_str(), &input.cohort];
        let files = videos.iter().flat_map(|video| [number(video.file.chunk()), number(video.file.file())]);
        let (mut whole, mut text) = (whole.into_iter().chain(files), text.into_iter());
        let mut times = videos.iter().flat_map(|video| [video.from, video.to]);
        let summaries = stats.summaries();
        let mut numbers = summaries.iter().flat_map(|(_, summary, _)| summary.values.iter().cloned());
        let mut counts = summaries.iter().map(|(_, summary, _)| i64::try_from(summary.count).unwrap_or(i64::MAX));
        for column in &mut self.columns {
            match column {
                Column::Whole(_, values) => values.extend(whole.next()),
                Column::Real(_, values) => values.extend(times.next()),
                Column::Text(_, values) => values.extend(text.next().map(str::to_owned)),
                Column::Texts(_, values) => values.push((*task).to_owned()),
                Column::Count(_, values) => values.extend(counts.next()),
                Column::Numbers(_, values) | Column::Channels(_, values) => values.extend(numbers.next()),
            }
        }
        self.rows += 1;
        if self.rows >= ROWS { self.encode() } else { Ok(()) }
    }

    pub(super) fn finish(mut self) -> Result<(), Problem> {
        self.encode()?;
        let closed = self.writer.close().map(|_| ());
        closed.map_err(Problem::encoding(&self.path))
    }

    fn encode(&mut self) -> Result<(), Problem> {
        if self.rows == 0 {
            return Ok(());
        }
        self.rows = 0;
        let schema = Schema::new(self.columns.iter().map(Column::field).collect::<Vec<_>>());
        let arrays = self.columns.iter_mut().map(Column::take).collect();
        let batch = RecordBatch::try_new(Arc::new(schema), arrays).map_err(Problem::encoding(&self.path))?;
        self.writer.write(&batch).map_err(Problem::encoding(&self.path))?;
        self.writer.flush().map_err(Problem::encoding(&self.path))
    }
}

fn list(of: DataType) -> DataType {
    DataType::List(Arc::new(Field::new("item", of, true)))
}

impl Column {
    fn field(&self) -> Field {
        let (name, kind) = match self {
            Self::Whole(name, _) => (name, DataType::Int64),
            Self::Real(name, _) => (name, DataType::Float64),
            Self::Text(name, _) => (name, DataType::Utf8),
            Self::Texts(name, _) => (name, list(DataType::Utf8)),
            Self::Count(name, _) => (name, list(DataType::Int64)),
            Self::Numbers(name, _) => (name, list(DataType::Float64)),
            Self::Channels(name, _) => (name, list(list(list(DataType::Float64)))),
        };
        Field::new(name, kind, true)
    }

    /// The waiting values as an array.
    fn take(&mut self) -> ArrayRef {
        match self {
            Self::Whole(_, values) => Arc::new(Int64Array::from(std::mem::take(values))),
            Self::Real(_, values) => Arc::new(Float64Array::from(std::mem::take(values))),
            Self::Text(_, values) => Arc::new(StringArray::from(std::mem::take(values))),
            Self::Texts(_, values) => {
                let mut list = ListBuilder::new(StringBuilder::new());
                for text in values.drain(..) {
                    list.values().append_value(text);
                    list.append(true);
                }
                Arc::new(list.finish())
            }
            Self::Count(_, values) => {
                let mut list = ListBuilder::new(Int64Builder::new());
                for count in values.drain(..) {
                    list.values().append_value(count);
                    list.append(true);
                }
                Arc::new(list.finish())
            }
            Self::Numbers(_, values) => {
                let mut list = ListBuilder::new(Float64Builder::new());
                for numbers in values.drain(..) {
                    list.values().append_slice(&numbers);
                    list.append(true);
                }
                Arc::new(list.finish())
            }
            Self::Channels(_, values) => {
                let mut list = ListBuilder::new(ListBuilder::new(ListBuilder::new(Float64Builder::new())));
                for channels in values.drain(..) {
                    for channel in channels {
                        let row = list.values();
                        row.values().values().append_value(channel);
                        row.values().append(true);
                        row.append(true);
                    }
                    list.append(true);
                }
                Arc::new(list.finish())
            }
        }
    }
}
