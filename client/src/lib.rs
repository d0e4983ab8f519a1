//! The gleaner client: everything that a program needs to call a gleaner server.
//!
//! [`Client`] is the connection. Plain calls go through the generated service clients that it returns
//! (`client.tasks()`, `client.jobs()`, ...); calls that need a loop or a rule are methods:
//! [`Client::upload`] and [`Client::push`], [`Client::watch`] and [`Client::wait`], the downloads,
//! [`Client::score_recording`] and [`StepScorer`] for unstored data,
//! [`Client::control`] for robots ([`robot`]), [`Session`] for simulators whose time waits, and [`Client::drive`] for
//! closed-loop evaluation in the embedded one.
//!
//! Links no libtorch and prints nothing. The command line is the package `gleaner-cli`.

mod connection;
mod credentials;
mod digest;
mod download;
mod drive;
mod error;
mod file;
mod find;
mod labels;
mod lowest;
mod push;
mod reason;
mod retry;
pub mod robot;
mod scoring;
mod session;
mod token;
mod upload;
mod watch;

pub use connection::{Authorize, Client, Transport};
pub use credentials::Credentials;
pub use drive::{DrivePlan, Driven, DrivenEpisode, RealTime, Recorded};
pub use error::{ClientError, Result};
pub use find::{Found, Skipped, find_recordings};
pub use labels::{LabelledFile, outcome_from_word, read_labels};
pub use lowest::LowestScore;
pub use push::{PushEvent, PushItem, PushResult, Pushed};
pub use scoring::StepScorer;
pub use session::{Session, observation};
pub use token::Token;
pub use upload::{UploadLabel, Uploaded};
pub use watch::has_ended;
