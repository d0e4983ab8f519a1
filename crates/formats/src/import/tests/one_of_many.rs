//! One episode of a LeRobot dataset with many: its conversion reads what the episode needs, and gives what all tables state.

mod runs;

use std::fs::{self, File};
use std::sync::Arc;

use arrow_array::{ArrayRef, Float32Array, Int64Array, RecordBatch, StringArray};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use serde_json::{Value, json};

use super::*;

const STEPS: i64 = 3;
const EPISODES: &str = "meta/episodes/chunk-000/file-000.parquet";
const TASKS: &str = "meta/tasks.parquet";
const INFO: &str = "meta/info.json";
/// The columns of a data file that are whole numbers.
const WHOLE: [&str; 4] = ["frame_index", "episode_index", "index", "task_index"];

/// A dataset to be made.
#[derive(Clone, Copy, Debug)]
struct Made {
    version: &'static str,
    episodes: i64,
    /// Episodes of a data file.
    in_file: i64,
    /// Episodes of a row group of each table.
    in_group: i64,
    statistics: EnabledStatistics,
    /// Whether the tables of `meta` begin with the last episode.
    reversed: bool,
    /// Whether data files have the numbers of their episodes.
    numbered: bool,
}

const MADE: Made = Made {
    version: "v3.0",
    episodes: 12,
    in_file: 5,
    in_group: 1,
    statistics: EnabledStatistics::Chunk,
    reversed: false,
    numbered: true,
};

impl Made {
    fn write(self) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let lines = self.version != "v3.0";
        let mut features = json!({
            "observation.state": {"dtype": "float32", "shape": [1]},
            "action": {"dtype": "float32", "shape": [1]},
            "timestamp": {"dtype": "float32", "shape": [1]},
        });
        for name in WHOLE.iter().filter(|name| self.numbered || **name != "episode_index") {
            features[*name] = json!({"dtype": "int64", "shape": [1]});
        }
        let file = if lines { "episode_{episode_index:06d}" } else { "file-{file_index:03d}" };
        let info = json!({
            "codebase_version": self.version, "fps": 10, "total_episodes": self.episodes, "features": features,
            "data_path": format!("data/{file}.parquet"),
        });
        let mut numbers: Vec<i64> = (0..self.episodes).collect();
        if self.reversed {
            numbers.reverse();
        }
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("meta/episodes/chunk-000")).unwrap();
        fs::create_dir_all(at("data")).unwrap();
        fs::write(at(INFO), info.to_string()).unwrap();
        if lines {
            let text =
                |line: &dyn Fn(i64) -> Value| numbers.iter().map(|n| format!("{}\n", line(*n))).collect::<String>();
            let episodes = text(&|number| json!({"episode_index": number, "length": STEPS}));
            fs::write(at("meta/episodes.jsonl"), episodes).unwrap();
            let tasks = text(&|number| json!({"task_index": number, "task": format!("task {number}")}));
            fs::write(at("meta/tasks.jsonl"), tasks).unwrap();
        } else {
            let whole = |value: &dyn Fn(i64) -> i64| numbers.iter().map(|number| value(*number)).collect::<Vec<_>>();
            self.table(
                &at(EPISODES),
                1,
                vec![
                    ("episode_index", integers(whole(&|number| number))),
                    ("length", integers(whole(&|_| STEPS))),
                    ("data/chunk_index", integers(whole(&|_| 0))),
                    ("data/file_index", integers(whole(&|number| number / self.in_file))),
                    ("dataset_from_index", integers(whole(&|number| number * STEPS))),
                ],
            );
            let texts: StringArray = numbers.iter().map(|number| Some(format!("task {number}"))).collect();
            self.table(&at(TASKS), 1, vec![("task_index", integers(numbers.clone())), ("task", Arc::new(texts))]);
            for file in 0..self.episodes.div_euclid(self.in_file) + 1 {
                let episodes = file * self.in_file..((file + 1) * self.in_file).min(self.episodes);
                self.data(&at(&format!("data/file-{file:03}.parquet")), episodes);
            }
        }
        folder
    }

    fn data(self, path: &Path, episodes: std::ops::Range<i64>) {
        let rows: Vec<(i64, i64)> = episodes.flat_map(|episode| (0..STEPS).map(move |step| (episode, step))).collect();
        let whole = |value: &dyn Fn(i64, i64) -> i64| integers(rows.iter().map(|(e, s)| value(*e, *s)).collect());
        let real = |value: &dyn Fn(i64, i64) -> f32| -> ArrayRef {
            Arc::new(rows.iter().map(|(episode, step)| Some(value(*episode, *step))).collect::<Float32Array>())
        };
        let mut columns = vec![
            ("observation.state", real(&state)),
            ("action", real(&|_, _| 0.5)),
            ("timestamp", real(&|_, step| state(0, step) / 10.0)),
            ("frame_index", whole(&|_, step| step)),
            ("index", whole(&|episode, step| episode * STEPS + step)),
            ("task_index", whole(&|episode, _| episode)),
        ];
        if self.numbered {
            columns.push(("episode_index", whole(&|episode, _| episode)));
        }
        self.table(path, usize::try_from(STEPS).unwrap(), columns);
    }

    /// Writes a table with this many rows for each episode.
    fn table(self, path: &Path, rows_each: usize, columns: Vec<(&str, ArrayRef)>) {
        let batch = RecordBatch::try_from_iter(columns).unwrap();
        let properties = WriterProperties::builder().set_statistics_enabled(self.statistics).build();
        let mut writer = ArrowWriter::try_new(File::create(path).unwrap(), batch.schema(), Some(properties)).unwrap();
        let group = usize::try_from(self.in_group).unwrap() * rows_each;
        for at in (0..batch.num_rows()).step_by(group) {
            writer.write(&batch.slice(at, group.min(batch.num_rows() - at))).unwrap();
            writer.flush().unwrap();
        }
        writer.close().unwrap();
    }
}

fn integers(values: Vec<i64>) -> ArrayRef {
    Arc::new(Int64Array::from(values))
}

/// The state of a step: another one in each step of each episode.
fn state(episode: i64, step: i64) -> f32 {
    f32::from(i16::try_from(episode * 10 + step).unwrap())
}

/// Overwrites every column of each row group but one.
fn damage_others(path: &Path, kept: usize) {
    let mut bytes = fs::read(path).unwrap();
    let table = ParquetRecordBatchReaderBuilder::try_new(File::open(path).unwrap()).unwrap();
    let groups = table.metadata().row_groups().iter().enumerate().filter(|(at, _)| *at != kept);
    for (begin, length) in groups.flat_map(|(_, group)| group.columns()).map(|column| column.byte_range()) {
        let place = usize::try_from(begin).unwrap()..usize::try_from(begin + length).unwrap();
        bytes[place].fill(0xff);
    }
    fs::write(path, bytes).unwrap();
}

fn converted(dataset: &Path, episode: u64) -> Result<Vec<u8>, String> {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.mcap");
    let converted = convert(dataset, &Assumed::default(), episode, &out);
    converted.map(|_| fs::read(out).unwrap()).map_err(|error| error.to_string())
}

#[test]
fn row_groups_of_other_episodes_are_not_decoded() {
    let dataset = MADE.write();
    let dataset = dataset.path();
    let whole = converted(dataset, 8).unwrap();
    // Episode 8 is the fourth one of the second data file.
    for (name, kept) in [(EPISODES, 8), (TASKS, 8), ("data/file-001.parquet", 3)] {
        damage_others(&dataset.join(name), kept);
        assert!(converted(dataset, 8).unwrap() == whole, "{name}");
        let error = converted(dataset, 7).unwrap_err();
        assert!(error.contains("file-000.parquet") && error.contains("the table is damaged"), "{name}: {error}");
        let error = describe(dataset, &Assumed::default()).unwrap_err().to_string();
        assert!(error.contains("file-000.parquet") && error.contains("the table is damaged"), "{name}: {error}");
    }
}

#[test]
fn lines_of_other_episodes_are_not_parsed() {
    let dataset = Made { version: "v2.1", episodes: 1000, ..MADE }.write();
    let dataset = dataset.path();
    MADE.data(&dataset.join("data/episode_000999.parquet"), 999..1000);
    let whole = converted(dataset, 999).unwrap();
    for name in ["meta/tasks.jsonl", "meta/episodes.jsonl"] {
        let text = fs::read_to_string(dataset.join(name)).unwrap();
        let damaged =
            text.lines().enumerate().map(|(at, line)| if at < 400 { "{\n".to_owned() } else { format!("{line}\n") });
        fs::write(dataset.join(name), damaged.collect::<String>()).unwrap();
        assert!(converted(dataset, 999).unwrap() == whole, "{name}");
    }
    for error in [converted(dataset, 300).unwrap_err(), describe(dataset, &Assumed::default()).unwrap_err().to_string()]
    {
        assert!(error.contains("episodes.jsonl") && error.contains("line 1: "), "{error}");
    }
}

fn layouts() -> [(&'static str, Made); 7] {
    [
        ("a row group each", MADE),
        ("several episodes in a row group", Made { in_group: 4, ..MADE }),
        ("one row group", Made { in_group: 100, in_file: 100, ..MADE }),
        ("no statistics", Made { statistics: EnabledStatistics::None, ..MADE }),
        ("statistics of pages", Made { statistics: EnabledStatistics::Page, in_group: 4, ..MADE }),
        ("no order", Made { reversed: true, in_group: 5, ..MADE }),
        ("no numbers in data files", Made { numbered: false, in_group: 2, ..MADE }),
    ]
}

#[test]
fn an_episode_is_found_in_tables_of_any_layout() {
    for (case, made) in layouts() {
        let dataset = made.write();
        for number in 0..12 {
            let (episode, _, result) = steps(dataset.path(), number);
            let number = i64::try_from(number).unwrap();
            assert_eq!(result.steps, 3, "{case}, {number}");
            assert_eq!(episode.proprioception(), [0, 1, 2].map(|step| state(number, step)), "{case}, {number}");
            let task = format!("[\"task {number}\"]");
            let recording = converted(dataset.path(), number.unsigned_abs()).unwrap();
            assert!(recording.windows(task.len()).any(|part| part == task.as_bytes()), "{case}, {number}");
        }
        let beyond = converted(dataset.path(), 12).unwrap_err();
        assert!(beyond.contains("there is no episode 12: the dataset has 12"), "{beyond}");
    }
}

#[test]
fn an_episode_that_tables_lack_or_have_twice_is_an_error() {
    let (few, many) = (Made { episodes: 11, ..MADE }.write(), MADE.write());
    fs::copy(few.path().join(EPISODES), many.path().join(EPISODES)).unwrap();
    let error = converted(many.path(), 11).unwrap_err();
    assert!(error.contains("states 12 episodes, and meta/episodes has 11"), "{error}");
    fs::copy(few.path().join(EPISODES), many.path().join("meta/episodes/chunk-000/file-001.parquet")).unwrap();
    let error = converted(many.path(), 3).unwrap_err();
    assert!(error.contains("or has it twice"), "{error}");

    let lines = Made { version: "v2.1", ..MADE }.write();
    let path = lines.path().join("meta/episodes.jsonl");
    let text = fs::read_to_string(&path).unwrap();
    for number in [0, 3, 11] {
        MADE.data(&lines.path().join(format!("data/episode_{number:06}.parquet")), number..number + 1);
        let number = number.unsigned_abs();
        fs::write(&path, &text).unwrap();
        converted(lines.path(), number).unwrap();
        let twice = text.lines().zip(0..).flat_map(|(line, at)| vec![line; if at == number { 2 } else { 1 }]);
        fs::write(&path, twice.map(|line| format!("{line}\n")).collect::<String>()).unwrap();
        let error = converted(lines.path(), number).unwrap_err();
        assert!(error.contains("or has it twice"), "{number}: {error}");
    }
}
