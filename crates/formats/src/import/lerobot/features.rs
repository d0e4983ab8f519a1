//! The features of a dataset: which are pictures, which numbers of the robot, and which are kept beside them.

use std::collections::{BTreeMap, BTreeSet};

use gleaner_core::CameraSpec;

use super::info::{Feature, Info};
use crate::import::description::{Description, empty_task};
use crate::import::fields::{Stated, Vector, fields};
use crate::import::recorder::with_mapping;
use crate::problem::Problem;

/// Beginnings of the names of the robot's numbers.
const OBSERVATION: &str = "observation.";
const ACTION: &str = "action";
/// Beginning of the names of pictures.
const IMAGES: &str = "observation.images.";
const DEPTH: &str = "_depth";
/// Types of numbers.
const NUMBERS: [&str; 11] =
    ["float32", "float64", "float16", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "bool"];

/// Where the pictures of a camera are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    /// In the table, as files of images.
    Table,
    /// In a file of video.
    Video,
}

/// The pictures of one feature.
#[derive(Clone, Debug)]
pub(super) struct Picture {
    pub(super) feature: String,
    /// Its camera's place in the task.
    pub(super) camera: usize,
    pub(super) depth: bool,
    pub(super) source: Source,
    /// (height, width), as declared.
    pub(super) size: (u32, u32),
}

/// The features of a dataset, sorted.
pub(super) struct Features {
    pub(super) pictures: Vec<Picture>,
    /// Features that are the proprioception, and the action, with their number of values.
    pub(super) state: Vec<(String, usize)>,
    pub(super) action: Vec<(String, usize)>,
    /// Everything else.
    pub(super) others: Vec<String>,
    /// Features whose exact values steps cannot hold, which are kept beside them too.
    pub(super) wide: BTreeSet<String>,
    pub(super) description: Description,
}

impl Features {
    pub(super) fn new(info: &Info, stats: &BTreeMap<String, Vec<Stated>>) -> Result<Self, Problem> {
        let mut features = Self {
            pictures: Vec::new(),
            state: Vec::new(),
            action: Vec::new(),
            others: Vec::new(),
            wide: BTreeSet::new(),
            description: Description {
                format: String::new(),
                episodes: 0,
                steps: 0,
                rate_stated: true,
                environment: None,
                spec: empty_task(info.fps),
                fields: Vec::new(),
                cameras: Vec::new(),
                left_out: Vec::new(),
            },
        };
        let whole_action = info.features.contains_key(ACTION);
        let mut depths = Vec::new();
        for (name, feature) in &info.features {
            match feature.dtype.as_str() {
                "image" | "video" if is_depth(feature) => depths.push((name, feature)),
                "image" | "video" => features.camera(name, feature)?,
                dtype if NUMBERS.contains(&dtype) => features.numbers(name, feature, whole_action),
                "string" => features.others.push(name.clone()),
                other => {
                    let problem = format!(
                        "feature {name} has the type {other:?}, which is not read; remove it, as with \
                         `lerobot-edit-dataset --operation.type remove_feature`"
                    );
                    return Err(wrong(&problem));
                }
            }
        }
        depths.into_iter().try_for_each(|(name, feature)| features.depth(name, feature))?;
        // A policy's state comes first, whatever comes before it in the alphabet.
        features.state.sort_by_key(|(name, _)| name != "observation.state");
        features.fields(info, stats)?;
        Ok(features)
    }

    /// Keeps the exact values of a column with one number or flag beside the steps, also of one that is in them.
    ///
    /// # Errors
    /// The columns that there are.
    pub(super) fn keep_column<'a>(&mut self, info: &'a Info, name: &str) -> Result<(), Vec<&'a str>> {
        let single = |(_, feature): &(&String, &Feature)| {
            NUMBERS.contains(&feature.dtype.as_str()) && matches!(feature.shape.as_slice(), [] | [1])
        };
        let known: Vec<&str> = info.features.iter().filter(single).map(|(name, _)| name.as_str()).collect();
        if !known.contains(&name) {
            return Err(known);
        }
        if !self.others.iter().any(|other| other == name) {
            self.wide.insert(name.to_owned());
        }
        Ok(())
    }

    /// The pictures that lie in the table.
    pub(super) fn stored(&self) -> impl Iterator<Item = &Picture> {
        self.pictures.iter().filter(|picture| picture.source == Source::Table)
    }

    fn numbers(&mut self, name: &str, feature: &Feature, whole_action: bool) {
        let size = feature.shape.iter().map(|&side| side as usize).fold(1, usize::saturating_mul);
        let numbered = (name.to_owned(), size);
        let of_action = if whole_action { name == ACTION } else { name.starts_with(ACTION) };
        if of_action {
            self.action.push(numbered);
        } else if name.starts_with(OBSERVATION) {
            self.state.push(numbered);
        } else {
            return self.others.push(name.to_owned());
        }
        if feature.dtype != "float32" {
            self.wide.insert(name.to_owned());
        }
    }

    fn camera(&mut self, name: &str, feature: &Feature) -> Result<(), Problem> {
        let (height, width) = size(name, feature)?;
        let source = if feature.dtype == "video" { Source::Video } else { Source::Table };
        let description = &mut self.description;
        let camera = plain(name.strip_prefix(IMAGES).unwrap_or(name));
        let origin = match source {
            Source::Table => format!("{name}, images"),
            Source::Video => format!("{name}, video"),
        };
        let spec = CameraSpec { name: camera, height, width, depth: false, recorded: None };
        let picture = Picture {
            feature: name.to_owned(),
            camera: description.spec.cameras.len(),
            depth: false,
            source,
            size: (height, width),
        };
        description.spec.cameras.push(spec);
        description.cameras.push(format!("{origin} of {height}×{width} pixels"));
        self.pictures.push(picture);
        Ok(())
    }

    /// Depth belongs to the camera with its name and size.
    fn depth(&mut self, name: &str, feature: &Feature) -> Result<(), Problem> {
        if feature.dtype == "video" {
            let reason = "depth as video of 12 bits is not read; convert it to images";
            self.description.leave_out(name, reason);
            return Ok(());
        }
        let size = size(name, feature)?;
        let color = name
            .strip_suffix(DEPTH)
            .and_then(|color| self.pictures.iter().find(|picture| picture.feature == color && picture.size == size));
        let spec = color.and_then(|color| self.description.spec.cameras.get_mut(color.camera));
        let (Some(color), Some(spec)) = (color, spec) else {
            let reason = "no feature with color has its name without _depth and its size";
            self.description.leave_out(name, reason);
            return Ok(());
        };
        spec.depth = true;
        if let Some(origin) = self.description.cameras.get_mut(color.camera) {
            *origin += &format!(", with depth of {name}");
        }
        let picture = Picture { feature: name.to_owned(), depth: true, source: Source::Table, ..color.clone() };
        self.pictures.push(picture);
        Ok(())
    }

    fn fields(&mut self, info: &Info, stats: &BTreeMap<String, Vec<Stated>>) -> Result<(), Problem> {
        if self.action.is_empty() {
            return Err(wrong("there is no feature `action`; gleaner needs the commands of the robot"));
        }
        let vector = |(name, size): &(String, usize)| {
            let names = info.names.get(name).cloned().unwrap_or_default();
            let stated = stats.get(name).filter(|stated| stated.len() == *size).cloned().unwrap_or_default();
            Vector {
                feature: name.clone(),
                name: name.strip_prefix(OBSERVATION).unwrap_or(name).to_owned(),
                size: u32::try_from(*size).unwrap_or(u32::MAX),
                names,
                stated,
            }
        };
        let vectors = |of: &[(String, usize)]| of.iter().map(vector).collect::<Vec<_>>();
        let (state, action, origins) = fields(&vectors(&self.state), &vectors(&self.action));
        let description = &mut self.description;
        description.fields = origins;
        (description.spec.proprioception, description.spec.action) = (state, action);
        description.spec = with_mapping(description.spec.clone());
        gleaner_recording::validate(&description.spec).map_err(|error| wrong(&error.to_string()))
    }
}

fn is_depth(feature: &Feature) -> bool {
    ["is_depth_map", "video.is_depth_map"].iter().any(|key| feature.info[*key] == true)
}

/// (height, width) of a picture, whose channels may come first or last.
fn size(name: &str, feature: &Feature) -> Result<(u32, u32), Problem> {
    let first = feature.names[0].as_str().is_some_and(|name| name.starts_with("channel"));
    match feature.shape.as_slice() {
        [_, height, width] if first => Ok((*height, *width)),
        [height, width, _] => Ok((*height, *width)),
        shape => {
            Err(wrong(&format!("feature {name} has the shape {shape:?}, and a picture has three sides; correct it")))
        }
    }
}

/// A camera's name as a task may have it.
fn plain(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || "_-.".contains(c) { c } else { '_' }).collect()
}

fn wrong(problem: &str) -> Problem {
    Problem::Unfit(format!("meta/info.json: {problem}"))
}
