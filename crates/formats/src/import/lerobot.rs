//! LeRobot datasets v3.0, v2.1 and v2.0: parquet tables with pictures in them or in videos beside them.
//!
//! The versions differ in the places of their files alone, which `places` knows.

mod cells;
mod features;
mod info;
mod lines;
mod names;
mod places;
mod rows;
mod run;
mod tables;
mod tasks;
mod videos;

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use gleaner_recording::{CameraMessage, ImageRef, PixelFormat};
use serde_json::{Map, Value, json};

use self::features::{Features, Picture, Source};
use self::info::Info;
use self::places::Place;
use self::rows::Row;
use self::run::Run;
use self::videos::Reel;
use super::description::Description;
use super::recorder::Recorder;
use super::{Assumed, Dataset, no_success_column};
use crate::problem::Problem;

/// Seconds by which a row's timestamp may differ from its place.
const STAMP_TOLERANCE: f64 = 2e-3;
/// The column of the outcome where no other is named: that of the last row counts.
const SUCCESS: &str = "next.success";
/// The file that describes the dataset.
const INFO: &str = "meta/info.json";

struct Lerobot {
    folder: PathBuf,
    info: Info,
    features: Features,
    /// The column whose last value is the outcome.
    success: String,
    run: Run,
}

/// Opens a dataset in a folder with `meta/info.json`, which alone is read.
pub(super) fn open(folder: &Path, assumed: &Assumed) -> Result<Box<dyn Dataset>, Problem> {
    let info = Info::read(folder)?;
    let mut features = Features::new(&info, &BTreeMap::new())?;
    let success = match &assumed.success_column {
        Some(column) => {
            let problem = |known: Vec<&str>| unfit(&folder.join(INFO), &no_success_column(column, &known));
            features.keep_column(&info, column).map_err(problem)?;
            column.clone()
        }
        None => SUCCESS.to_owned(),
    };
    Ok(Box::new(Lerobot { folder: folder.to_owned(), info, features, success, run: Run::default() }))
}

impl Dataset for Lerobot {
    fn episodes(&self) -> u64 {
        self.info.total_episodes
    }

    fn description(&self) -> Result<Description, Problem> {
        let features = Features::new(&self.info, &info::stats(&self.folder))?;
        let places = places::read(&self.folder, &self.info, &features)?;
        let tasks = tasks::read(&self.folder, &self.info)?;
        self.check_files(&places)?;
        let mut spec = features.description.spec;
        // Episodes of several tasks have no instruction in common.
        if let Some(text) = tasks::only(&tasks) {
            spec.instruction = text.to_owned();
        }
        Ok(Description {
            spec,
            format: self.format(),
            episodes: count(places.len()),
            steps: places.iter().map(|place| place.steps).fold(0, u64::saturating_add),
            rate_stated: true,
            ..features.description
        })
    }

    fn record(&mut self, episodes: Range<u64>, out: &Path) -> Result<(Recorder, Option<bool>), Problem> {
        // A reader that panics leaves none of its state to the next episode.
        let mut run = std::mem::take(&mut self.run);
        let recorded = self.record_in(&mut run, &episodes, out);
        self.run = run;
        recorded
    }
}

impl Lerobot {
    fn format(&self) -> String {
        format!("LeRobot {}", self.info.codebase_version)
    }

    fn record_in(&self, run: &mut Run, episodes: &Range<u64>, out: &Path) -> Result<(Recorder, Option<bool>), Problem> {
        let episode = episodes.start;
        let place = &run.place(self, episodes)?;
        let mut reels = self.reels(run, place)?;
        let mut recorder = Recorder::create(out, episode.to_string(), &self.features.description.spec)?;
        let (mut texts, mut success) = (Vec::new(), None);
        let mut step = 0;
        while let Some(row) = run.row(self, place, step)? {
            self.check_row(&row, place, step)?;
            let stamp = recorder.step_stamp(step);
            for (picture, bytes) in self.features.stored().zip(&row.pictures) {
                let image = ImageRef { format: PixelFormat::Auto, data: bytes };
                let message = if picture.depth { CameraMessage::Depth(image) } else { CameraMessage::Color(image) };
                recorder.camera(picture.camera, stamp, message)?;
            }
            for reel in &mut reels {
                reel.write_to(step, &mut recorder)?;
            }
            let mut others = row.others;
            let task = others.get("task_index").and_then(Value::as_i64);
            let task = task.map(|index| run.texts.of(&self.folder, &self.info, index)).transpose()?;
            if let Some(task) = task.flatten() {
                others.insert("task".to_owned(), json!(task));
                if !texts.iter().any(|text| text == task) {
                    texts.push(task.to_owned());
                }
            }
            success = others.get(&self.success).and_then(truth);
            recorder.step(&row.state, &row.action, others)?;
            step += 1;
        }
        if step != place.steps {
            let problem = format!(
                "{} has {step} rows of episode {episode}, and meta/episodes states {}; download it again",
                place.data.display(),
                place.steps
            );
            return Err(unfit(&self.folder, &problem));
        }
        recorder.metadata(self.metadata(place, &texts))?;
        Ok((recorder, success))
    }

    /// Looks for every file that an episode needs; the error names the first that is missing.
    fn check_files(&self, places: &[Place]) -> Result<(), Problem> {
        let files = places.iter().flat_map(|place| {
            let videos = place.videos.values().map(|video| &video.path);
            std::iter::once(&place.data).chain(videos).map(move |path| (place.episode, path))
        });
        match files.into_iter().find(|(_, path)| !self.folder.join(path).is_file()) {
            Some((episode, path)) => Err(unfit(
                &self.folder,
                &format!("{} is missing, which episode {episode} needs; download the whole dataset", path.display()),
            )),
            None => Ok(()),
        }
    }

    fn reels(&self, run: &mut Run, place: &Place) -> Result<Vec<Reel>, Problem> {
        let of = |picture: &Picture| {
            let part = place.videos.get(&picture.feature);
            let part = part.ok_or_else(|| {
                unfit(&self.folder, &format!("{}: episode {} has no video", picture.feature, place.episode))
            })?;
            let film = run.film(&picture.feature, &self.folder.join(&part.path))?;
            Reel::new(film, picture, part, (place.steps, self.info.fps))
        };
        self.features.pictures.iter().filter(|picture| picture.source == Source::Video).map(of).collect()
    }

    /// The row must be the one that its place in the tables states.
    fn check_row(&self, row: &Row, place: &Place, step: u64) -> Result<(), Problem> {
        let wrong = |problem: String| Err(unfit(&self.folder.join(&place.data), &problem));
        let whole = |name: &str| row.others.get(name).and_then(Value::as_u64);
        for (name, expected) in [("episode_index", place.episode), ("frame_index", step)] {
            if whole(name).is_some_and(|found| found != expected) {
                return wrong(format!(
                    "{name} of row {step} of episode {} is {}, and the tables of episodes state {expected}; download the \
                     dataset again",
                    place.episode,
                    whole(name).unwrap_or_default()
                ));
            }
        }
        #[expect(clippy::cast_precision_loss, reason = "an episode has few steps")]
        let expected = step as f64 / self.info.fps;
        match row.others.get("timestamp").and_then(Value::as_f64) {
            Some(found) if (found - expected).abs() > STAMP_TOLERANCE => wrong(format!(
                "row {step} of episode {} has the timestamp {found:.4} s, and at {} fps it is at {expected:.4} s; correct \
                 `fps` in meta/info.json",
                place.episode, self.info.fps
            )),
            Some(_) | None => Ok(()),
        }
    }

    fn metadata(&self, place: &Place, tasks: &[String]) -> BTreeMap<String, String> {
        let features = serde_json::to_string(&self.info.features).unwrap_or_default();
        let entries = [
            ("format", self.format()),
            ("episode", place.episode.to_string()),
            ("fps", self.info.fps.to_string()),
            ("robot_type", self.info.robot_type.clone().unwrap_or_default()),
            ("tasks", json!(tasks).to_string()),
            ("features", features),
        ];
        entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
    }
}

/// A flag, or a number that stands for one.
fn truth(value: &Value) -> Option<bool> {
    value.as_bool().or_else(|| value.as_f64().map(|number| number > 0.0))
}

/// The rest of a row's columns, by their names.
type Others = Map<String, Value>;

fn count(length: usize) -> u64 {
    u64::try_from(length).unwrap_or(u64::MAX)
}

/// The error of a file that cannot be opened, for `map_err`.
fn unopened(path: &Path) -> impl Fn(std::io::Error) -> Problem {
    move |error| {
        if error.kind() == std::io::ErrorKind::NotFound {
            return unfit(path, "it is missing; download the whole dataset");
        }
        Problem::io(path)(error)
    }
}

fn unfit(path: &Path, problem: &str) -> Problem {
    Problem::Unfit(format!("{}: {problem}", path.display()))
}
