//! A small tabletop simulator with rendered RGBD cameras, a scripted expert and graded imperfect agents.
//!
//! A [`Sim`] is one attempt at a [`Task`] that any policy can drive: observe, step, until done. [`demonstrate`] has an
//! agent drive it and [`record_set`] writes whole sets of such attempts as MCAP with labels and marks. [`task_spec`]
//! says how the recordings are read. The crate knows nothing of servers or learning.
//!
//! One seed fixes everything: the same arguments give the same bytes. Motion is control at 10 Hz in 8 substeps. The
//! gripper stays upright, is as fast as it is told within bounds, pushes cubes with its fingers, lands on them, and
//! holds one only when both pads close on it, near enough, deep enough and turned little enough. A cube let go falls:
//! it stays on another when its centre is over it, else slides off. A held cube lands on another and pushes it; cubes
//! never tip over.
//!
//! An evaluation drives many [`Sim`]s at once; they are plain values. [`compatible`] tells which task and settings
//! fit a task that recordings were made for.
//!
//! # Tasks
//!
//! | task | asked | success, for 2 steps with every cube still | seen only in the pictures |
//! |---|---|---|---|
//! | `pick_cube` | carry the red cube to the goal, on the table or in the air | its centre within 3 cm of the goal | the cube |
//! | `stack_cube` | put the red cube on the green one and let go | it lies on the green one with its centre over it, not held | both cubes |
//!
//! # Agents
//!
//! Success over the seeds 0 to 499 with the default limit of 60 steps, `pick_cube` / `stack_cube` in percent; the
//! expert takes 25 / 27 steps on average. The mark is the first step at which the agent does other than the expert
//! would; below, on average, as a share of the attempt.
//!
//! | agent | fault | grade 0.3 | 0.5 | 0.7 | 1 | mark at 1 |
//! |---|---|---|---|---|---|---|
//! | `expert` | none (100 / 100) | | | | | none |
//! | `missed_grasp` | grasp point off by 3.2–4.8 cm × grade; carries on whatever it holds | 98 / 98 | 53 / 53 | 7 / 7 | 0 / 0 | 0.05 / 0.05 |
//! | `early_release` | opens for good in the carry: in its first third at grade 1, later or not at all at lower grades | 80 / 84 | 58 / 66 | 23 / 37 | 6 / 0 | 0.29 / 0.26 |
//! | `wrong_goal` | carries to 15–22 cm × grade^2.5 beside the place (stacking: sets it down there) | 100 / 100 | 56 / 8 | 0 / 0 | 0 / 0 | 0.22 / 0.22 |
//! | `freeze` | from a random step moves at (1 − grade)² of the expert's speed | 100 / 100 | 77 / 64 | 15 / 14 | 0 / 1 | 0.19 / 0.20 |
//! | `wander` | from a random step heads for random points, each 7 steps anew with the grade's chance | 92 / 91 | 66 / 72 | 36 / 42 | 0 / 0 | 0.18 / 0.20 |
//! | `noise` | from a random step adds uniform noise of half-width 2.4 × grade to every delta | 91 / 90 | 30 / 40 | 3 / 18 | 0 / 8 | 0.12 / 0.13 |
//!
//! Beside the mark, [`Demonstration::departure`] says for every step how far it is from what the expert would do
//! there. Measured by the example `measure`; the example `contact_sheet` draws an attempt.

mod agent;
mod config;
mod demonstration;
mod error;
mod render;
mod set;
mod sim;
mod task;
mod world;

/// Changes when the same seed gives another episode: recordings of another version are no longer what they say.
pub const VERSION: u32 = 1;

pub use agent::{AgentKind, AgentSpec};
pub use config::SimConfig;
pub use demonstration::{Demonstration, METADATA, demonstrate};
pub use error::SimError;
pub use set::{Cohort, LABELS, MARKS, RecordedEpisode, record_set};
pub use sim::{Observation, Sim};
pub use task::{ACTION_SIZE, GOAL_RADIUS, Task, compatible, compatible_with, simulated, task_spec};
