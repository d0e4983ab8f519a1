//! A small tabletop simulator with rendered RGBD cameras, a scripted expert and graded imperfect agents.
//!
//! The crate produces demonstrations with known faults, on which scores are validated, and evaluates policies. It depends on
//! `gleaner-recording` for its files, and on neither servers nor learning.
//!
//! - [`Sim`] is one attempt at a [`Task`]: a policy observes and steps until it is done. A `Sim` is a plain value, so an
//!   evaluation runs many at once.
//! - [`demonstrate`] runs an attempt of an agent; [`record_set`] writes sets of attempts as MCAP with labels and marks.
//! - [`task_spec`] is the specification with which the recordings are read; [`compatible`] finds the task and the settings
//!   that fit a specification.
//!
//! ```
//! use gleaner_sim::{Sim, SimConfig, Task};
//!
//! let mut sim = Sim::new(Task::PickCube, SimConfig { image: 16, ..SimConfig::default() }, 7);
//! let observation = sim.observe();
//! assert_eq!(observation.proprioception.len(), 15);
//! sim.step(&[0.0, 0.0, -0.5, 0.0, 0.0, 0.0, 1.0]);
//! assert!(!sim.done());
//! ```
//!
//! # Motion
//!
//! The same arguments give the same bytes: one seed determines every random choice. Control runs at 10 Hz in 8 substeps. The
//! gripper stays upright, moves at the commanded speed within bounds, pushes cubes with its fingers, stops on top of them,
//! and holds one only if both pads close on it, near enough, deep enough and with a small enough rotation. A released cube
//! falls; it stays on another if its centre is over it, and slides off otherwise. A held cube stops on another and pushes
//! it; cubes never tip over.
//!
//! # Tasks
//!
//! | task | goal | success, for 2 steps with every cube still | visible in the images only |
//! |---|---|---|---|
//! | `pick_cube` | carry the red cube to the goal, on the table or in the air | its centre within 3 cm of the goal | the cube |
//! | `stack_cube` | put the red cube on the green one and release it | it lies on the green one with its centre over it, not held | both cubes |
//!
//! # Agents
//!
//! Success over the seeds 0 to 499 with the default limit of 60 steps, `pick_cube` / `stack_cube` in percent; the
//! expert takes 25 / 27 steps on average. The mark is the first step whose action differs from the
//! expert's; below is its average as a share of the attempt.
//!
//! | agent | fault | grade 0.3 | 0.5 | 0.7 | 1 | mark at 1 |
//! |---|---|---|---|---|---|---|
//! | `expert` | none (100 / 100) | | | | | none |
//! | `missed_grasp` | grasp point wrong by 3.2–4.8 cm × grade; continues without the cube | 98 / 98 | 53 / 53 | 7 / 7 | 0 / 0 | 0.05 / 0.05 |
//! | `early_release` | opens the gripper during the carry: in its first third at grade 1, later or not at all at lower grades | 80 / 84 | 58 / 66 | 23 / 37 | 6 / 0 | 0.29 / 0.26 |
//! | `wrong_goal` | carries to 15–22 cm × grade^2.5 beside the place (stacking: sets it down there) | 100 / 100 | 56 / 8 | 0 / 0 | 0 / 0 | 0.22 / 0.22 |
//! | `freeze` | from a random step moves at (1 − grade)² of the expert's speed | 100 / 100 | 77 / 64 | 15 / 14 | 0 / 1 | 0.19 / 0.20 |
//! | `wander` | from a random step, every 7 steps, moves towards a random point with a probability of the grade | 92 / 91 | 66 / 72 | 36 / 42 | 0 / 0 | 0.18 / 0.20 |
//! | `noise` | from a random step adds uniform noise of half-width 2.4 × grade to every delta | 91 / 90 | 30 / 40 | 3 / 18 | 0 / 8 | 0.12 / 0.13 |
//!
//! With `+false_start`, as in `noise:1+false_start`, an agent moves towards random points for its first 8 to 20 steps, and
//! then follows its script from where it is; [`Demonstration::went_right`] is the first of these steps, and its fault comes
//! later.
//!
//! [`Demonstration::departure`] is the distance of each action from the expert's in the same state. The example `measure`
//! produced these numbers; the example `contact_sheet` draws an attempt.

mod agent;
mod config;
mod demonstration;
mod error;
mod render;
mod set;
mod sim;
mod task;
mod world;

/// The version of the simulator, which changes when a seed gives another episode.
pub const VERSION: u32 = 1;

pub use agent::{AgentKind, AgentSpec};
pub use config::SimConfig;
pub use demonstration::{Demonstration, METADATA, demonstrate};
pub use error::SimError;
pub use set::{Cohort, LABELS, MARKS, RecordedEpisode, record_set};
pub use sim::{Observation, Sim};
pub use task::{ACTION_SIZE, GOAL_RADIUS, Task, compatible, compatible_with, simulated, task_spec};
