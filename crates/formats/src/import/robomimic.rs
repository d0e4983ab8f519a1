//! robomimic HDF5: each demonstration is an episode.
//!
//! Pictures are read some rows at a time. `next_obs` repeats `obs` one step later and is not read.

mod demo;
mod entries;

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use gleaner_core::{CameraSpec, ValueRange};
use gleaner_recording::{CameraMessage, ImageRef, PixelFormat};
use hdf5_pure::{AttrValue, Error, File, Group};
use serde_json::{Value, json};

use self::demo::Demo;
use self::entries::{Entry, Kind};
use super::description::{Description, empty_task};
use super::fields::{Stated, Vector, fields, identifier};
use super::recorder::{Recorder, with_mapping};
use super::{Assumed, Dataset, Undescribed, no_success_column};
use crate::problem::Problem;

/// Steps a second where the file does not state them: those of robosuite's tasks.
const RATE: f64 = 20.0;
/// Rates that a task may have.
const RATES: std::ops::RangeInclusive<f64> = 0.01..=10_000.0;
const DATA: &str = "data";
/// How the names of demonstrations begin.
const DEMO: &str = "demo_";

struct Robomimic {
    path: PathBuf,
    file: File,
    /// The demonstrations by their numbers.
    demos: Vec<String>,
    /// The observations of every demonstration.
    entries: Vec<Entry>,
    /// For each camera of the task, its color and its depth.
    cameras: Vec<(String, Option<String>)>,
    /// The range by which gleaner's export rescaled the actions.
    rescaled: Option<(Vec<f64>, Vec<f64>)>,
    about: BTreeMap<String, String>,
    /// The column whose last value is the outcome, instead of the rewards.
    success_column: Option<String>,
    description: Description,
}

/// Opens a file.
pub(super) fn open(path: &Path, assumed: &Assumed) -> Result<Box<dyn Dataset>, Undescribed> {
    let damaged = damaged(path);
    let file = File::open_streaming(path).map_err(&damaged)?;
    if file.file_size() < file.superblock().eof_address {
        let problem = format!("the file is cut: it states {} bytes; copy it again", file.superblock().eof_address);
        return Err(unfit(path, &problem).into());
    }
    let data = data_group(path, &file)?;
    let groups = data.groups().map_err(&damaged)?;
    let mut demos: Vec<String> = groups.iter().filter(|name| name.starts_with(DEMO)).cloned().collect();
    demos.sort_by_key(|name| (name.rsplit('_').next().and_then(|number| number.parse::<u64>().ok()), name.clone()));
    let Some(first) = demos.first() else {
        let other = groups.first().map(|name| format!("{name:?} and ")).unwrap_or_default();
        return Err(other_program(path, &format!("its group `{DATA}` has {other}no {DEMO}N")));
    };
    let attrs = data.attrs().map_err(&damaged)?;
    let first = Demo::open(path, &file, first)?;
    let stated = stated_rate(&attrs);
    let rate = assumed.rate_hz.or(stated).unwrap_or(RATE);
    if !RATES.contains(&rate) {
        return Err(unfit(path, &format!("the rate is {rate} Hz, and from 0.01 to 10000 are read; add --rate")).into());
    }
    let steps = demos.iter().map(|demo| steps(&data, demo)).try_fold(0_u64, |sum, steps| Some(sum + steps?));
    let steps = steps.ok_or_else(|| unfit(path, "a demonstration has no `actions`; remove it"))?;
    let rescaled = floats(&attrs, "gleaner_action_low").zip(floats(&attrs, "gleaner_action_high"));
    let rescaled = rescaled.filter(|(low, high)| low.len() == first.action_size && high.len() == first.action_size);
    let entries = first.entries()?;
    if let Some(column) = &assumed.success_column {
        let known = first.single_columns()?;
        if !known.contains(column) {
            let known: Vec<&str> = known.iter().map(String::as_str).collect();
            return Err(unfit(path, &no_success_column(column, &known)).into());
        }
    }
    let mut opened = Robomimic {
        path: path.to_owned(),
        about: texts(&attrs),
        demos: demos.clone(),
        cameras: Vec::new(),
        rescaled,
        success_column: assumed.success_column.clone(),
        description: Description {
            format: "robomimic HDF5".to_owned(),
            episodes: u64::try_from(demos.len()).unwrap_or(u64::MAX),
            steps,
            rate_stated: assumed.rate_hz.or(stated).is_some(),
            environment: environment_name(&attrs),
            spec: empty_task(rate),
            fields: Vec::new(),
            cameras: Vec::new(),
            left_out: Vec::new(),
        },
        entries,
        file: file.clone(),
    };
    opened.describe(first.action_size)?;
    Ok(Box::new(opened))
}

impl Robomimic {
    /// The task that the observations and actions form.
    fn describe(&mut self, action_size: usize) -> Result<(), Problem> {
        let description = &mut self.description;
        let name = |entry: &Entry, ending: &str| entry.key.strip_suffix(ending).unwrap_or(&entry.key).to_owned();
        let mut depths: BTreeMap<String, &Entry> = BTreeMap::new();
        for entry in self.entries.iter().filter(|entry| matches!(entry.kind, Kind::Depth(..))) {
            depths.insert(name(entry, "_depth"), entry);
        }
        let mut state = Vec::new();
        for entry in &self.entries {
            match &entry.kind {
                Kind::Color(height, width) => {
                    let camera = name(entry, "_image");
                    let fits = |depth: &&Entry| depth.kind == Kind::Depth(*height, *width);
                    let depth = depths.remove(&camera).filter(fits).map(|depth| depth.key.clone());
                    let with = depth.as_ref().map(|depth| format!(", with depth of obs/{depth}")).unwrap_or_default();
                    description.cameras.push(format!("obs/{}, images of {height}×{width} pixels{with}", entry.key));
                    let (name, depth_there) = (identifier(&camera), depth.is_some());
                    let (height, width) = (*height, *width);
                    let spec = CameraSpec { name, height, width, depth: depth_there, recorded: None };
                    description.spec.cameras.push(spec);
                    self.cameras.push((entry.key.clone(), depth));
                }
                Kind::Numbers(size) => state.push(Vector {
                    feature: format!("obs/{}", entry.key),
                    name: entry.key.clone(),
                    size: u32::try_from(*size).unwrap_or(u32::MAX),
                    names: Vec::new(),
                    stated: Vec::new(),
                }),
                Kind::Depth(..) => {}
                Kind::Other(reason) => description.leave_out(format!("obs/{}", entry.key), reason),
            }
        }
        for depth in depths.values() {
            description.leave_out(format!("obs/{}", depth.key), "no camera has its name and size");
        }
        // robomimic's policies act within [-1, 1].
        let (low, high) = self.rescaled.clone().unwrap_or((vec![-1.0; action_size], vec![1.0; action_size]));
        let ranges = low.iter().zip(&high).map(|(&minimum, &maximum)| ValueRange { minimum, maximum });
        let action = Vector {
            feature: "actions".to_owned(),
            name: "action".to_owned(),
            size: u32::try_from(action_size).unwrap_or(u32::MAX),
            names: Vec::new(),
            stated: ranges.map(Stated::range).collect(),
        };
        let (state, action, origins) = fields(&state, &[action]);
        (description.spec.proprioception, description.spec.action) = (state, action);
        description.fields = origins;
        description.spec = with_mapping(description.spec.clone());
        gleaner_recording::validate(&description.spec).map_err(|error| unfit(&self.path, &error.to_string()))
    }

    /// The action as it was before gleaner's export rescaled it to [-1, 1].
    fn action(&self, row: &[f32]) -> Vec<f32> {
        let Some((low, high)) = &self.rescaled else { return row.to_vec() };
        let restore = |((&value, &low), &high): ((&f32, &f64), &f64)| {
            #[expect(clippy::cast_possible_truncation, reason = "steps hold 32-bit floats")]
            let restored = ((f64::from(value) + 1.0) / 2.0 * (high - low) + low) as f32;
            if (low, high) == (-1.0, 1.0) { value } else { restored }
        };
        row.iter().zip(low).zip(high).map(restore).collect()
    }
}

impl Dataset for Robomimic {
    fn episodes(&self) -> u64 {
        self.description.episodes
    }

    fn description(&self) -> Result<Description, Problem> {
        Ok(self.description.clone())
    }

    fn record(&mut self, episodes: Range<u64>, out: &Path) -> Result<(Recorder, Option<bool>), Problem> {
        let episode = episodes.start;
        let name = usize::try_from(episode).ok().and_then(|at| self.demos.get(at));
        let name = name.ok_or_else(|| unfit(&self.path, &format!("there is no episode {episode}")))?;
        let demo = Demo::open(&self.path, &self.file, name)?;
        demo.check(&self.entries)?;
        let spec = &self.description.spec;
        let mut recorder = Recorder::create(out, name.clone(), spec)?;
        let (states, actions) = (demo.numbers(&self.entries)?, demo.actions()?);
        let others = demo.others()?;
        for step in 0..demo.steps {
            let stamp = recorder.step_stamp(step);
            for (camera, (color, depth)) in self.cameras.iter().enumerate() {
                let data = demo.color(color, step)?;
                let color = CameraMessage::Color(ImageRef { format: PixelFormat::Rgb8, data: &data });
                recorder.camera(camera, stamp, color)?;
                if let Some(depth) = depth {
                    recorder.camera(camera, stamp, CameraMessage::DepthMetres(&demo.depth(depth, step)?))?;
                }
            }
            let row = |values: &[f32], size: usize| {
                let at = usize::try_from(step).unwrap_or(usize::MAX).saturating_mul(size);
                values.get(at..at.saturating_add(size)).unwrap_or_default().to_vec()
            };
            let state: Vec<f32> = states.iter().flat_map(|(size, values)| row(values, *size)).collect();
            let action = self.action(&row(&actions, demo.action_size));
            recorder.step(&state, &action, others.row(step))?;
        }
        let mut about = self.about.clone();
        about.extend(texts(&demo.attrs()?).into_iter().map(|(key, value)| (format!("{name}.{key}"), value)));
        about.insert("format".to_owned(), self.description.format.clone());
        about.insert("episode".to_owned(), name.clone());
        recorder.metadata(about)?;
        Ok((recorder, others.success(self.success_column.as_deref())))
    }
}

/// The number of steps of a demonstration.
fn steps(data: &Group, demo: &str) -> Option<u64> {
    data.dataset(&format!("{demo}/actions")).ok()?.shape().ok()?.first().copied()
}

/// The rate that gleaner's export states, or the environment of robosuite.
fn stated_rate(attrs: &std::collections::HashMap<String, AttrValue>) -> Option<f64> {
    let own = floats(attrs, "gleaner_rate_hz").and_then(|rate| rate.first().copied());
    let environment = || environment_of(attrs)?["env_kwargs"]["control_freq"].as_f64();
    own.or_else(environment)
}

/// The name of the environment, if the file states one.
fn environment_name(attrs: &std::collections::HashMap<String, AttrValue>) -> Option<String> {
    let environment = environment_of(attrs)?;
    environment["env_name"].as_str().filter(|name| !name.is_empty()).map(str::to_owned)
}

/// What the file states of its environment.
fn environment_of(attrs: &std::collections::HashMap<String, AttrValue>) -> Option<Value> {
    serde_json::from_str(&texts(attrs).remove("env_args")?).ok()
}

#[expect(clippy::wildcard_enum_match_arm, reason = "attributes have many types")]
fn floats(attrs: &std::collections::HashMap<String, AttrValue>, name: &str) -> Option<Vec<f64>> {
    match attrs.get(name)? {
        AttrValue::F64Array(values) => Some(values.clone()),
        AttrValue::F32Array(values) => Some(values.iter().copied().map(f64::from).collect()),
        AttrValue::F64(value) => Some(vec![*value]),
        AttrValue::F32(value) => Some(vec![f64::from(*value)]),
        _ => None,
    }
}

/// The attributes as texts, those that are neither text nor a number as they are shown.
#[expect(clippy::wildcard_enum_match_arm, reason = "attributes have many types")]
fn texts(attrs: &std::collections::HashMap<String, AttrValue>) -> BTreeMap<String, String> {
    let text = |value: &AttrValue| match value {
        AttrValue::F64(number) => json!(number).to_string(),
        AttrValue::I64(number) => number.to_string(),
        other => other.as_str().map_or_else(|| format!("{other:?}"), str::to_owned),
    };
    attrs.iter().map(|(name, value)| (name.clone(), text(value))).collect()
}

/// The group with the demonstrations. A file without it is of another program if its root can be read.
fn data_group(path: &Path, file: &File) -> Result<Group, Undescribed> {
    let error = match file.group(DATA) {
        Ok(data) => return Ok(data),
        Err(error) => error,
    };
    let groups = file.root().groups().map_err(damaged(path))?;
    if groups.iter().any(|name| name == DATA) {
        return Err(damaged(path)(error).into());
    }
    Err(other_program(path, &format!("it has no group `{DATA}`")))
}

fn other_program(path: &Path, lack: &str) -> Undescribed {
    Undescribed::OtherProgram(format!("{}: {lack}; it is no HDF5 file of robomimic", path.display()))
}

/// Wraps an error of reading the file, for `map_err`.
fn damaged(path: &Path) -> impl Fn(Error) -> Problem {
    move |error| unfit(path, &format!("{error}; the file is damaged or cut, or not in HDF5: copy it again"))
}

fn unfit(path: &Path, problem: &str) -> Problem {
    Problem::Unfit(format!("{}: {problem}", path.display()))
}
