//! The numbers of one field over a recording: values at paths, or the pose of a frame.

use super::Failure;
use crate::dialect::Value;
use crate::error::RecordingError;
use crate::path::{Missing, Path};
use crate::transforms::{self, Tree};
use gleaner_core::{FieldSource, FindingCode, Transform};

/// Most numbers of one field over the recording.
const MAX_NUMBERS: usize = 500_000_000;

/// The numbers of one field source.
#[derive(Debug)]
pub(crate) struct FieldTrack {
    pub(crate) mapping: usize,
    pub(crate) source: usize,
    pub(crate) size: usize,
    /// Which messages of the topic carry the field.
    pub(crate) messages: Vec<usize>,
    /// `size` numbers of each of them.
    pub(crate) values: Vec<f32>,
    pub(crate) failure: Option<Failure>,
    /// Why a message that can be read does not carry the field.
    pub(crate) absent: Option<String>,
    place: Place,
}

/// Where the numbers are in a message.
#[derive(Debug)]
enum Place {
    Paths { paths: Vec<Path>, names: Vec<String> },
    Pose(Transform),
}

impl FieldTrack {
    pub(super) fn new(
        source: &FieldSource,
        (mapping, at): (usize, usize),
        size: usize,
    ) -> Result<Self, RecordingError> {
        let paths = source.paths.iter().map(|path| {
            Path::parse(path).map_err(|problem| RecordingError::Field {
                topic: source.topic.clone(),
                path: path.clone(),
                problem,
            })
        });
        let place = match &source.transform {
            Some(transform) => Place::Pose(transform.clone()),
            None => Place::Paths { paths: paths.collect::<Result<_, _>>()?, names: source.names.clone() },
        };
        Ok(Self {
            mapping,
            source: at,
            size,
            messages: Vec::new(),
            values: Vec::new(),
            failure: None,
            absent: None,
            place,
        })
    }

    /// The topic of the transforms that never change, of a pose.
    pub(super) fn fixed(&self) -> Option<&str> {
        match &self.place {
            Place::Pose(transform) => Some(&transform.static_topic),
            Place::Paths { .. } => None,
        }
    }

    /// Takes the numbers at the paths in a message.
    pub(super) fn push(&mut self, at: usize, message: &Value<'_>) -> Result<(), RecordingError> {
        let Place::Paths { paths, names } = &self.place else { return Ok(()) };
        let mut numbers = Vec::with_capacity(self.size);
        for path in paths {
            let found = if names.is_empty() {
                path.numbers(message, &mut numbers)
            } else {
                path.numbers_by_name(message, names, &mut numbers)
            };
            match found {
                Ok(()) => {}
                // Arm and gripper often alternate on one topic: these joints are in another message.
                Err(Missing::Names(problem)) => {
                    self.absent.get_or_insert_with(|| {
                        format!("no message has all the names of the mapping: {problem}; correct the mapping's names")
                    });
                    return Ok(());
                }
                Err(Missing::Path(problem)) => {
                    self.fail(at, &problem);
                    return Ok(());
                }
            }
        }
        self.add(at, &numbers)
    }

    /// Takes the pose after a message whose transforms are in the tree; `updated` has their number before it.
    pub(super) fn push_pose(
        &mut self,
        at: usize,
        tree: &Tree,
        updated: &Result<u64, String>,
    ) -> Result<(), RecordingError> {
        let Place::Pose(Transform { parent, child, .. }) = &self.place else { return Ok(()) };
        let before = match updated {
            Ok(before) => *before,
            Err(problem) => {
                self.fail(at, problem);
                return Ok(());
            }
        };
        match tree.pose(parent, child, before) {
            Ok(pose) => self.add(at, &pose.numbers()),
            // Each publisher sends its own part of the tree.
            Err(transforms::Missing::Chain | transforms::Missing::Unchanged) => Ok(()),
        }
    }

    /// Names what is missing after the last message, for a pose that no message has.
    pub(super) fn explain(&mut self, tree: &Tree) {
        let Place::Pose(Transform { parent, child, .. }) = &self.place else { return };
        self.absent = match tree.pose(parent, child, 0) {
            _ if !self.messages.is_empty() => None,
            Err(transforms::Missing::Chain) => {
                Some(format!("{}; correct `parent`, `child` or `static_topic`", tree.gap(parent, child)))
            }
            Ok(_) | Err(transforms::Missing::Unchanged) => {
                Some(format!("no message changes `{child}` in `{parent}`: the transforms between them never change"))
            }
        };
    }

    fn fail(&mut self, at: usize, problem: &str) {
        Failure::record(&mut self.failure, FindingCode::MissingField, || format!("message {at}: {problem}"));
    }

    fn add(&mut self, at: usize, numbers: &[f64]) -> Result<(), RecordingError> {
        if numbers.len() != self.size {
            let found = numbers.len();
            Failure::record(&mut self.failure, FindingCode::WrongSize, || {
                format!(
                    "message {at} gives {found} values, the task expects {}; correct the paths or the size",
                    self.size
                )
            });
            return Ok(());
        }
        if self.values.len() >= MAX_NUMBERS {
            return Err(RecordingError::TooLarge {
                problem: format!("a field has more than {MAX_NUMBERS} values; split the recording"),
            });
        }
        self.messages.push(at);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "steps hold 32-bit floats; beyond them is infinite and found"
        )]
        self.values.extend(numbers.iter().map(|&number| number as f32));
        Ok(())
    }
}
