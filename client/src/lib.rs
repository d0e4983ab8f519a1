//! The client library of gleaner: connections, uploads, jobs, scores and sessions of a gleaner server.
//!
//! - [`Client`] is the connection; `client.tasks()`, `client.jobs()` and the like return the generated client of each service.
//! - [`Client::upload`], [`Client::push`] and the downloads transfer recordings, and [`Client::check`] checks them first;
//!   [`find_recordings`] and [`read_labels`] find them.
//! - [`Client::download_export`] writes the files of a dataset into a new folder, and [`Client::export_episode`] one whole
//!   episode with its scores.
//! - [`Client::snapshot_episodes`] lists the episodes of a snapshot of any size.
//! - [`Client::submit_job`] and [`Client::submit_pipeline`] queue a job and a chain of jobs, each once also over a broken
//!   connection; [`Client::watch`] and [`Client::wait`] follow a job.
//! - [`Client::every_task`], [`Client::every_policy`] and the like list every row, page by page.
//! - [`Client::score_recording`] and [`StepScorer`] score what is not stored; [`Client::import_scores`] stores scores made
//!   elsewhere, which [`read_scores`] reads.
//! - [`Session`] acts in lock step, for simulators; [`Client::control`] runs a robot ([`robot`]) at a fixed rate;
//!   [`Client::drive`] evaluates a deployment in the embedded simulator.
//!
//! The library links no libtorch and prints nothing.
//!
//! ```no_run
//! use gleaner_client::Client;
//!
//! # async fn list() -> gleaner_client::Result<()> {
//! let client = Client::connect("http://127.0.0.1:7400", None).await?;
//! for task in client.every_task().await?.tasks {
//!     println!("{}", task.id);
//! }
//! # Ok(())
//! # }
//! ```

mod check;
mod connection;
mod credentials;
mod digest;
mod direct;
mod download;
mod drive;
mod error;
mod export;
mod file;
mod find;
mod foreign;
mod import;
mod label_guess;
mod labels;
mod lists;
mod lowest;
mod parts;
mod push;
mod ranges;
mod reason;
mod retry;
pub mod robot;
mod rows;
mod score_table;
mod scoring;
mod session;
mod snapshot;
mod source;
mod submit;
mod token;
mod upload;
mod watch;

pub use check::Checked;
pub use connection::{Authorize, Client, Transport};
pub use credentials::Credentials;
pub use drive::{DrivePlan, Driven, DrivenEpisode, RealTime, Recorded};
pub use error::{ClientError, Result};
pub use export::{expect_new_file, expect_new_folder};
pub use find::{Found, Skipped, find_recordings};
pub use foreign::is_dataset;
pub use label_guess::{TableGuess, guess_table};
pub use labels::{LABELS_FILE, LabelTable, LabelledFile, outcome_from_word, read_labels, read_table};
pub use lowest::LowestScore;
pub use parts::METADATA as BAG_METADATA;
pub use push::{PushEvent, PushItem, PushResult, Pushed};
pub use ranges::{NamedRange, read_ranges};
pub use rows::rows;
pub use score_table::{ScoredEpisode, read_scores};
pub use scoring::StepScorer;
pub use session::{Session, observation};
pub use source::whole_recording;
pub use token::Token;
pub use upload::{UploadLabel, Uploaded};
pub use watch::has_ended;
