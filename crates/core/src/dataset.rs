//! Datasets, each a selection from a score run, and exports, the files made from a dataset.

use super::{
    id::{BlobId, DatasetId, EpisodeId, ScoreRunId, SnapshotId, TaskId},
    score::ScoreRun,
    selection::Selection,
    time::Millis,
};

/// A filtered, weighted view of a score run. It copies nothing.
#[derive(Debug, Clone)]
pub struct Dataset {
    /// Its id.
    pub id: DatasetId,
    /// Its task.
    pub task_id: TaskId,
    /// The run it filters; may not be finished yet.
    pub score_run_id: ScoreRunId,
    /// The imperfect segments that are kept.
    pub selection: Selection,
    /// When it was made.
    pub created_at: Millis,
}

/// A format of exports.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ExportFormat {
    /// The original messages of each kept stretch with their scores, experts as they were recorded, and a manifest.
    #[default]
    Mcap,
    /// A LeRobot dataset v3.0 with images in parquet, or with video.
    Lerobot,
    /// One HDF5 file for robomimic.
    Robomimic,
}

impl ExportFormat {
    /// Every format.
    pub const ALL: [Self; 3] = [Self::Mcap, Self::Lerobot, Self::Robomimic];

    /// Its word in specs.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Lerobot => "lerobot",
            Self::Robomimic => "robomimic",
        }
    }
}

/// The settings of an export.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct ExportSpec {
    /// Format of the files.
    pub format: ExportFormat,
    /// Whether depth is written too. MCAP always has it, as every topic of the recording.
    pub depth: bool,
    /// Whether pictures are videos instead of images. LeRobot only.
    pub video: bool,
    /// Whether imperfect episodes are written whole, rather than their kept stretches alone.
    pub whole: bool,
}

/// One file of an export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExportFile {
    /// Its name within the export, with `/` after each folder.
    pub name: String,
    /// The blob that holds it.
    pub blob: BlobId,
    /// Its size in bytes.
    pub size_bytes: u64,
}

/// Size of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DatasetCounts {
    /// Imperfect segments kept.
    pub kept_segments: u64,
    /// Imperfect episodes that contribute at least one.
    pub kept_episodes: u64,
    /// The experts' segments.
    pub expert_segments: u64,
}

/// Contents of a dataset, by reference to episodes and their steps.
#[derive(Debug, Clone)]
pub struct DatasetContents {
    /// The dataset.
    pub dataset: Dataset,
    /// The run it filters.
    pub run: ScoreRun,
    /// The run's snapshot.
    pub snapshot_id: SnapshotId,
    /// Every expert, whole, each segment with weight 1.
    pub experts: Vec<EpisodeId>,
    /// Imperfect episodes with at least one kept segment, in the snapshot's order.
    pub kept: Vec<KeptEpisode>,
}

/// The kept segments of one imperfect episode.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptEpisode {
    /// The episode.
    pub episode_id: EpisodeId,
    /// Its kept segments by end step, without their matches: a dataset may have millions.
    pub segments: Vec<WeightedSegment>,
}

/// One kept segment by its place and weight alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeightedSegment {
    /// The step the segment ends at.
    pub end_step: u32,
    /// Its q.
    pub weight: f32,
}

/// One kept segment.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptSegment {
    /// The step the segment ends at.
    pub end_step: u32,
    /// Its q.
    pub weight: f32,
    /// The nearest expert segment; `None` when the scorer matches nothing.
    pub nearest: Option<Nearest>,
}

/// An expert's segment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Nearest {
    /// The expert.
    pub episode_id: EpisodeId,
    /// The step the segment ends at.
    pub end_step: u32,
}
