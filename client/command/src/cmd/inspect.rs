//! `inspect`: what recordings hold, without a server and without a task.

mod survey;

use std::path::PathBuf;

use clap::Args;
use gleaner_client::{Found, find_recordings};
use gleaner_inspector::Assumed;

use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::inspector::Inspector;
use crate::intake::{self, Intake, Opened};
use survey::{document, shown};

#[derive(Args, Debug)]
pub(crate) struct InspectArgs {
    /// Recordings, or folders that are searched for *.mcap; or datasets of other programs, of which the first episode is
    /// shown: LeRobot's folder with meta/info.json, robomimic's *.hdf5, or a folder of them without recordings.
    #[arg(required = true)]
    paths: Vec<PathBuf>,
    /// Write the first picture of each camera into this folder, as JPEG; with several recordings into a folder for each.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Steps per second of a dataset of another program that does not state them. Default: 20.
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
}

impl InspectArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let (datasets, others) = intake::split(&self.paths);
        let assumed = Assumed { rate_hz: self.rate, ..Assumed::default() };
        intake::expect_datasets(&datasets, &assumed)?;
        let Opened { intakes, skipped, refused } = Intake::open_all(context, &datasets, &assumed).await?;
        let mut found = if others.is_empty() { Found::default() } else { find_recordings(&others)? };
        // A dataset in a folder may be given by its own path too.
        found.skipped.retain(|skipped| !datasets.iter().any(|dataset| dataset.path == skipped.path));
        found.skipped.extend(skipped);
        let mut made = Vec::new();
        for intake in &intakes {
            let episode = intake.episode(0).await?.map_err(Failure::message)?;
            found.recordings.push(episode.recording.clone());
            made.push((intake, episode));
        }
        let mut surveys = Inspector::find()?.survey(&found.recordings, self.pictures.as_deref()).await?;
        for (path, _) in &mut surveys {
            // The recordings of datasets lie in a folder of their own, which is of no use to a reader.
            if let Some((intake, _)) = made.iter().find(|(_, episode)| episode.recording == *path) {
                *path = intake.place(0);
            }
        }
        surveys.extend(refused.into_iter().map(|(path, why)| (path, Err(why))));
        context.output.result(
            || Ok(document(&intakes, &surveys, &found.skipped)),
            || intakes.iter().map(Intake::shown).collect::<String>() + &shown(&surveys, &found.skipped),
        )?;
        let failed = surveys.iter().filter(|(_, survey)| survey.is_err()).count();
        if failed > 0 {
            return Err(Failure::message(format!("{failed} of {} recordings cannot be read", surveys.len())));
        }
        context.output.next(next(made.len() == found.recordings.len()));
        Ok(())
    }
}

/// The next command: a dataset describes its own task.
fn next(datasets_alone: bool) -> &'static str {
    if datasets_alone { "gleaner push DATASET" } else { "gleaner task draft RECORDINGS > task.toml" }
}
