//! robomimic HDF5: each piece is a demonstration, with filter keys for experts and kept stretches.
//!
//! robomimic's policies act within [-1, 1], so actions beyond that are rescaled by the range of the dataset, which is kept
//! as attributes. The library writes a dataset of the file from memory, whole: one camera's pictures of one demonstration are
//! there at a time, so that memory grows with the longest demonstration and not with the dataset.

mod action_range;
mod pictures;

use std::path::PathBuf;

use gleaner_core::episode::Outcome;
use gleaner_core::snapshot::Role;
use gleaner_core::{FieldSpec, TaskSpec};
use hdf5_pure::{AttrValue, File, Group};

use self::action_range::ActionRange;
use self::pictures::{Pictures, check_lengths, pictures};
use crate::export::{Export, Numbers};
use crate::piece::Piece;
use crate::problem::Problem;

const FILE: &str = "dataset.hdf5";
/// Values of about this size together are written at once.
const STAGED_BYTES: usize = 64 << 20;
/// Most bytes of one camera's pictures in one demonstration. Writing them takes about four times that in
/// memory.
const MOST_PICTURES: usize = 2 << 30;
const DEFLATE: u32 = 4;
/// robomimic's number of environments of Gymnasium's interface.
const GYM: u32 = 2;
/// Every tenth demonstration is for validation.
const VALIDATION: usize = 10;

/// Writes the file.
pub(crate) fn write<E: Export>(export: &mut E, depth: bool) -> Result<(), E::Error> {
    let task = export.task().clone();
    check_lengths(export.pieces(), &task, depth)?;
    let range = ActionRange::of(export, task.action_size())?;
    let mut out = Out::create(export.folder().join(FILE))?;
    out.head(export, &task, &range)?;
    for at in 0..export.pieces().len() {
        let piece = export.pieces()[at].clone();
        let numbers = export.numbers(at)?;
        out.demo(&Demo { at, piece: &piece, numbers, task: &task }, &range)?;
        for pictures in pictures(&task, depth) {
            for (group, later) in [("obs", false), ("next_obs", true)] {
                let values = pictures.read(export, at, later)?;
                out.pictures(&format!("{}/{group}", name(at)), &pictures, piece.len(), values)?;
            }
        }
        out.commit_if_large()?;
        export.advance()?;
    }
    out.finish()?;
    export.finished(FILE)
}

/// One demonstration.
struct Demo<'a> {
    at: usize,
    piece: &'a Piece,
    numbers: Numbers,
    task: &'a TaskSpec,
}

/// The file that is being written.
struct Out {
    path: PathBuf,
    file: File,
    staged: usize,
}

impl Out {
    fn create(path: PathBuf) -> Result<Self, Problem> {
        let file = File::create(&path).map_err(Problem::encoding(&path))?;
        Ok(Self { path, file, staged: 0 })
    }

    /// What the whole file states: the environment, the range of actions, and the filter keys.
    fn head<E: Export>(&mut self, export: &E, task: &TaskSpec, range: &ActionRange) -> Result<(), Problem> {
        let environment = serde_json::json!({"env_name": task.name, "type": GYM, "env_kwargs": {}}).to_string();
        let total: usize = export.pieces().iter().map(Piece::len).sum();
        let wide = |values: &[f32]| AttrValue::F64Array(values.iter().copied().map(f64::from).collect());
        let root = self.file.root();
        let group = root.create_group_with("data", |group| {
            group.set_attr("total", AttrValue::I64(i64::try_from(total).unwrap_or(i64::MAX)));
            group.set_attr("env_args", AttrValue::String(environment));
            group.set_attr("gleaner_rate_hz", AttrValue::F64(task.rate_hz));
            group.set_attr("gleaner_action_low", wide(&range.low));
            group.set_attr("gleaner_action_high", wide(&range.high));
            for (name, value) in export.origin() {
                group.set_attr(&format!("gleaner_{name}"), AttrValue::String(value.clone()));
            }
        });
        group.map_err(Problem::encoding(&self.path))?;
        root.create_group("mask").map_err(Problem::encoding(&self.path))?;
        let names = |wanted: &dyn Fn(usize, &Piece) -> bool| -> Vec<String> {
            let pieces = export.pieces().iter().enumerate();
            pieces.filter(|(at, piece)| wanted(*at, piece)).map(|(at, _)| name(at)).collect()
        };
        for (key, names) in [
            ("experts", names(&|_, piece| piece.role() == Role::Expert)),
            ("kept", names(&|_, piece| piece.role() == Role::Imperfect && piece.is_kept())),
            ("train", names(&|at, _| at % VALIDATION != VALIDATION - 1)),
            ("valid", names(&|at, _| at % VALIDATION == VALIDATION - 1)),
        ] {
            // A filter key without demonstrations is an error where it is used, and is left out.
            if names.is_empty() {
                continue;
            }
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            let mut wrong = None;
            let staged = root.create_dataset(&format!("mask/{key}"), |dataset| {
                wrong = dataset.with_ascii_strings(&names).err();
            });
            if let Some(error) = wrong {
                return Err(Problem::encoding(&self.path)(error));
            }
            staged.map_err(Problem::encoding(&self.path))?;
        }
        self.commit()
    }

    fn demo(&mut self, demo: &Demo<'_>, range: &ActionRange) -> Result<(), Problem> {
        let Demo { at, piece, numbers, task } = demo;
        let (group, steps, input) = (format!("data/{}", name(*at)), piece.len(), piece.episode());
        let root = self.file.root();
        let text = |value: &str| AttrValue::String(value.to_owned());
        let made = root.create_group_with(&group, |made| {
            made.set_attr("num_samples", AttrValue::I64(i64::try_from(steps).unwrap_or(i64::MAX)));
            made.set_attr("gleaner_episode", text(input.id.as_str()));
            made.set_attr("gleaner_source", text(&input.file_name));
            made.set_attr("gleaner_role", text(piece.role().as_str()));
            made.set_attr("gleaner_outcome", text(input.outcome.as_str()));
            made.set_attr("gleaner_cohort", text(&input.cohort));
            made.set_attr("gleaner_first_step", AttrValue::I64(i64::try_from(piece.steps.start).unwrap_or(i64::MAX)));
        });
        made.map_err(Problem::encoding(&self.path))?;
        for made in ["obs", "next_obs"] {
            root.create_group(&format!("{group}/{made}")).map_err(Problem::encoding(&self.path))?;
        }
        let scores = piece.scores();
        let last = |at: usize| at + 1 == steps;
        let succeeded = piece.is_whole() && input.outcome == Outcome::Success;
        let mut writer = Writer { root: &root, group, steps, bytes: 0, path: &self.path };
        writer.floats("actions", &range.rescaled(&numbers.action), task.action_size())?;
        writer.scalars("rewards", (0..steps).map(|at| f32::from(u8::from(succeeded && last(at)))))?;
        writer.scalars("q", scores.iter().map(|score| score.q))?;
        writer.scalars("weights", scores.iter().map(|score| if score.kept { score.q } else { 0.0 }))?;
        writer.dones((0..steps).map(|at| i64::from(last(at))).collect())?;
        let mut offset = 0;
        for field in &task.proprioception {
            let width = field.size as usize;
            let of = |row: &[f32]| row.get(offset..offset + width).unwrap_or_default().to_vec();
            let values: Vec<f32> =
                numbers.proprioception.chunks_exact(task.proprioception_size().max(1)).flat_map(of).collect();
            for (group, values) in [("obs", values.clone()), ("next_obs", following(&values, width))] {
                writer.floats(&format!("{group}/{}", key(field)), &values, width)?;
            }
            offset += width;
        }
        self.staged += writer.bytes;
        Ok(())
    }

    /// Writes the pictures of a camera into a group of a demonstration.
    fn pictures(&mut self, group: &str, pictures: &Pictures, steps: usize, values: Vec<u8>) -> Result<(), Problem> {
        let name = format!("data/{group}/{}", pictures.name);
        self.staged += values.len();
        let made = self.file.root().create_dataset(&name, |dataset| pictures.describe(dataset, steps, values));
        made.map(|_| ()).map_err(Problem::encoding(&self.path))?;
        self.commit_if_large()
    }

    fn commit_if_large(&mut self) -> Result<(), Problem> {
        if self.staged >= STAGED_BYTES { self.commit() } else { Ok(()) }
    }

    fn commit(&mut self) -> Result<(), Problem> {
        self.staged = 0;
        self.file.commit().map_err(Problem::encoding(&self.path))
    }

    fn finish(mut self) -> Result<(), Problem> {
        self.commit()?;
        self.file.close().map_err(Problem::encoding(&self.path))
    }
}

/// Writes the datasets of one demonstration.
struct Writer<'a> {
    root: &'a Group,
    group: String,
    steps: usize,
    bytes: usize,
    path: &'a std::path::Path,
}

impl Writer<'_> {
    fn scalars(&mut self, name: &str, values: impl Iterator<Item = f32>) -> Result<(), Problem> {
        let values: Vec<f32> = values.collect();
        self.dataset(name, values.len() * 4, |dataset| {
            dataset.with_f32_data(&values);
        })
    }

    fn dones(&mut self, values: Vec<i64>) -> Result<(), Problem> {
        self.dataset("dones", values.len() * 8, |dataset| {
            dataset.with_i64_data(&values);
        })
    }

    fn floats(&mut self, name: &str, values: &[f32], width: usize) -> Result<(), Problem> {
        let shape = [count(self.steps), count(width)];
        self.dataset(name, values.len() * 4, |dataset| {
            dataset.with_f32_data(values).with_shape(&shape);
        })
    }

    fn dataset(
        &mut self,
        name: &str,
        bytes: usize,
        build: impl FnOnce(&mut hdf5_pure::DatasetBuilder),
    ) -> Result<(), Problem> {
        self.bytes += bytes;
        let made = self.root.create_dataset(&format!("{}/{name}", self.group), build);
        made.map(|_| ()).map_err(Problem::encoding(self.path))
    }
}

fn name(at: usize) -> String {
    format!("demo_{at}")
}

/// The field's name, without what separates groups in a file.
fn key(field: &FieldSpec) -> String {
    field.name.replace('/', "_")
}

/// The rows one step later; the last one repeats.
fn following<T: Copy>(rows: &[T], width: usize) -> Vec<T> {
    let later = rows.get(width..).unwrap_or_default();
    let last = rows.len().checked_sub(width).and_then(|from| rows.get(from..)).unwrap_or_default();
    [later, last].concat()
}

fn count(length: usize) -> u64 {
    u64::try_from(length).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests;
