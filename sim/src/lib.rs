//! A small tabletop simulator with rendered RGBD cameras, a scripted expert and graded imperfect agents.

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
