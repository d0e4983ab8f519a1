//! A small tabletop simulator with rendered RGBD cameras, a scripted expert and graded imperfect agents.
//!
//! A [`Sim`] is one attempt at a [`Task`] that any policy can drive: observe, step, until done. [`demonstrate`] has an
//! agent drive it and [`record_set`] writes whole sets of such attempts as MCAP with labels and marks. [`task_spec`]
//! says how the recordings are read. The crate knows nothing of servers or learning.
//!
//! One seed fixes everything: the same arguments give the same bytes. Motion is control at 10 Hz in 8 substeps. The
//! gripper stays upright, is as fast as it is told within bounds, pushes the cube with its fingers, lands on it, and
//! holds it only when both pads close on it, near enough, deep enough and turned little enough. A cube let go falls.
//!
//! # Agents
//!
//! Success over the seeds 0 to 499 with the default limit of 60 steps; the expert takes 25 steps on average. The mark
//! is the first step at which the agent does other than the expert would; below, on average, as a share of the attempt.
//!
//! | agent | fault | success at grade 0.5 | at grade 1 | mark at grade 1 |
//! |---|---|---|---|---|
//! | `expert` | none | 100 % | 100 % | none |
//! | `missed_grasp` | grasp point off by 3.2–4.8 cm × grade; carries on whatever it holds | 53.2 % | 0.0 % | 0.05 |
//! | `early_release` | opens for good in the carry: in its first third at grade 1, later at lower grades | 25.6 % | 6.2 % | 0.29 |
//! | `wrong_goal` | carries to 5–10 cm × grade beside the goal | 35.0 % | 0.0 % | 0.22 |
//! | `freeze` | from a random step moves at (1 − grade)² of the expert's speed | 77.2 % | 0.0 % | 0.19 |
//! | `wander` | from a random step heads for random points, each 7 steps anew with the grade's chance | 65.8 % | 0.2 % | 0.18 |
//! | `noise` | from a random step adds uniform noise of half-width 2.4 × grade to every delta | 30.0 % | 0.0 % | 0.12 |
//!
//! Measured by the example `measure`; the example `contact_sheet` draws an attempt.

mod agent;
mod config;
mod demonstration;
mod error;
mod render;
mod set;
mod sim;
pub mod statistics;
mod task;
mod world;

pub use agent::{AgentKind, AgentSpec};
pub use config::SimConfig;
pub use demonstration::{Demonstration, METADATA, demonstrate};
pub use error::SimError;
pub use set::{LABELS, MARKS, RecordedEpisode, record_set};
pub use sim::{Observation, Sim};
pub use task::{ACTION_SIZE, GOAL_RADIUS, Task, task_spec};
