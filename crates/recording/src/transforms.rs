//! Poses of frames: the tree of transforms that a robot publishes, link by link.
//!
//! Works on [`Value`] alone, so it is the same for every dialect: `tf2_msgs/TFMessage` and `geometry_msgs/TransformStamped`
//! of ROS, `foxglove.FrameTransforms` and `foxglove.FrameTransform`.

use std::collections::HashMap;

use glam::{DQuat, DVec3};

use crate::dialect::Value;

/// Most frames of a recording.
const MAX_FRAMES: usize = 10_000;
/// Most frames from one to the root of its tree.
const MAX_DEPTH: usize = 64;
/// Longest name of a frame in bytes.
const MAX_NAME: usize = 255;
/// Frames that an error lists.
const SHOWN: usize = 24;
/// A quaternion shorter than this has no direction.
const SHORTEST: f64 = 1e-6;

/// Where a frame is in another, and how it is turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pose {
    place: DVec3,
    turn: DQuat,
}

impl Pose {
    const SAME: Self = Self { place: DVec3::ZERO, turn: DQuat::IDENTITY };

    /// The position and the quaternion x, y, z, w.
    pub(crate) fn numbers(&self) -> [f64; 7] {
        let ([x, y, z], [qx, qy, qz, qw]) = (self.place.to_array(), self.turn.to_array());
        [x, y, z, qx, qy, qz, qw]
    }

    /// The pose in this one's frame of what has the pose `inner` in this one.
    fn then(&self, inner: &Self) -> Self {
        Self { place: self.place + self.turn * inner.place, turn: self.turn * inner.turn }
    }

    fn inverse(&self) -> Self {
        let turn = self.turn.conjugate();
        Self { place: -(turn * self.place), turn }
    }

    /// A transform of a message. Numbers that a message leaves out are zero; a rotation that it leaves out does not turn.
    fn of(transform: &Value<'_>) -> Result<Self, String> {
        let part = |name: &str, axis: &str| transform.field(name).and_then(|part| part.number(axis)).unwrap_or(0.0);
        let place = DVec3::from_array(["x", "y", "z"].map(|axis| part("translation", axis)));
        if transform.field("rotation").is_none() {
            return Ok(Self { place, ..Self::SAME });
        }
        let turn = DQuat::from_array(["x", "y", "z", "w"].map(|axis| part("rotation", axis)));
        if turn.length() < SHORTEST {
            return Err("its quaternion is zero".to_owned());
        }
        Ok(Self { place, turn: turn.normalize() })
    }
}

/// The newest transform of each frame in its parent.
#[derive(Debug, Default)]
pub(crate) struct Tree {
    frames: HashMap<String, Link>,
    /// Transforms so far.
    count: u64,
    /// What was left out first.
    left_out: Option<String>,
}

#[derive(Debug)]
struct Link {
    parent: String,
    pose: Pose,
    /// The number of its transform among all.
    at: u64,
}

/// Why a message has no pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Missing {
    /// No chain of transforms leads from one frame to the other so far.
    Chain,
    /// The message changes no transform between them.
    Unchanged,
}

impl Tree {
    /// Takes the transforms of a message. Returns the number of transforms before it.
    ///
    /// # Errors
    /// The reason why the message has no transforms, or one too many.
    pub(crate) fn update(&mut self, message: &Value<'_>) -> Result<u64, String> {
        let before = self.count;
        match message.field("transforms") {
            Some(Value::List(transforms)) => transforms.iter().try_for_each(|transform| self.add(transform))?,
            // An empty list of messages.
            Some(Value::Numbers(none)) if none.is_empty() => {}
            Some(other) => return Err(format!("`transforms` is {}, not a list of transforms", other.kind())),
            None => self.add(message)?,
        }
        Ok(before)
    }

    fn add(&mut self, transform: &Value<'_>) -> Result<(), String> {
        let child = transform.text("child_frame_id");
        let parent = transform
            .text("parent_frame_id")
            .or_else(|| transform.field("header").and_then(|head| head.text("frame_id")));
        let (Some(child), Some(parent)) = (child, parent) else {
            return Err(format!("{} has no `child_frame_id` or no frame of its parent", transform.kind()));
        };
        if child.len().max(parent.len()) > MAX_NAME {
            return Err(format!("a frame has a name of more than {MAX_NAME} bytes"));
        }
        let pose = match Pose::of(transform.field("transform").unwrap_or(transform)) {
            Ok(pose) => pose,
            // As other readers do, which keep the transform before.
            Err(problem) => {
                self.leave_out(|| format!("a transform from `{parent}` to `{child}` was left out: {problem}"));
                return Ok(());
            }
        };
        let (child, parent) = (bare(child).to_owned(), bare(parent).to_owned());
        self.count += 1;
        if self.frames.len() >= MAX_FRAMES && !self.frames.contains_key(&child) {
            return Err(format!("there are more than {MAX_FRAMES} frames"));
        }
        self.frames.insert(child, Link { parent, pose, at: self.count });
        Ok(())
    }

    /// The pose of `child` in `parent`, if a transform between them came after the first `before`.
    pub(crate) fn pose(&self, parent: &str, child: &str, before: u64) -> Result<Pose, Missing> {
        let (own, others) = (self.ancestors(bare(child)), self.ancestors(bare(parent)));
        let Some(up) = own.iter().position(|frame| others.contains(frame)) else {
            return Err(Missing::Chain);
        };
        let down = others.iter().position(|frame| *frame == own[up]).unwrap_or_default();
        let (own, others) = (&own[..up], &others[..down]);
        let newest = own.iter().chain(others).filter_map(|frame| self.frames.get(*frame)).map(|link| link.at).max();
        if newest.is_none_or(|newest| newest <= before) {
            return Err(Missing::Unchanged);
        }
        Ok(self.among(others).inverse().then(&self.among(own)))
    }

    /// The pose of the first of these frames, each the child of the next, in the parent of the last.
    fn among(&self, frames: &[&str]) -> Pose {
        let links = frames.iter().filter_map(|frame| self.frames.get(*frame));
        links.fold(Pose::SAME, |inner, link| link.pose.then(&inner))
    }

    /// Notes what was left out, if it is the first.
    pub(crate) fn leave_out(&mut self, problem: impl FnOnce() -> String) {
        self.left_out.get_or_insert_with(problem);
    }

    /// A frame, its parent, and so on.
    fn ancestors<'a>(&'a self, frame: &'a str) -> Vec<&'a str> {
        let mut found = vec![frame];
        // Frames in a circle have no root.
        while let Some(link) =
            found.last().and_then(|frame| self.frames.get(*frame)).filter(|_| found.len() <= MAX_DEPTH)
        {
            found.push(&link.parent);
        }
        found
    }

    /// Why no chain leads from one frame to the other.
    pub(crate) fn gap(&self, parent: &str, child: &str) -> String {
        let left_out = self.left_out.as_ref().map(|problem| format!("; {problem}")).unwrap_or_default();
        if self.frames.is_empty() {
            return format!("there are no transforms{left_out}");
        }
        let mut frames: Vec<&str> =
            self.frames.iter().flat_map(|(frame, link)| [frame.as_str(), link.parent.as_str()]).collect();
        frames.sort_unstable();
        frames.dedup();
        let more = if frames.len() > SHOWN { ", …" } else { "" };
        let shown = frames.iter().take(SHOWN).copied().collect::<Vec<_>>().join(", ");
        match [child, parent].into_iter().find(|frame| !frames.contains(&bare(frame))) {
            Some(frame) => format!("there is no frame `{frame}`; the frames are {shown}{more}{left_out}"),
            None => format!("no transforms connect `{child}` with `{parent}`; the frames are {shown}{more}{left_out}"),
        }
    }
}

/// The stamp of a message of transforms: that of its first one.
pub(crate) fn stamp(message: &Value<'_>) -> Option<i64> {
    match message.field("transforms") {
        Some(Value::List(transforms)) => transforms.first()?.stamp(),
        Some(_) | None => message.stamp(),
    }
}

/// A frame's name; those of old recorders begin with a slash.
fn bare(frame: &str) -> &str {
    frame.strip_prefix('/').unwrap_or(frame)
}

#[cfg(test)]
mod tests;
