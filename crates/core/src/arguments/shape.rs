//! The shape of a selection as command-line options. Must not depend on jobs.

use clap::{ArgMatches, Args, Command, FromArgMatches};

use super::{Given, Of, Options};
use crate::schema::Problem;
use crate::selection::SelectionShape;

/// The options of a [`SelectionShape`].
#[derive(Debug, Clone, Copy)]
struct OfShape;

impl Options for OfShape {
    const HEADING: &'static str = "Shape of the selection, applied in this order";

    fn settings() -> Vec<(Of, &'static str)> {
        let settings = <SelectionShape as crate::Group>::schema();
        settings.into_iter().map(|setting| ((setting, Vec::new()), "")).collect()
    }
}

impl Args for SelectionShape {
    fn augment_args(command: Command) -> Command {
        Given::<OfShape>::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for SelectionShape {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let given = Given::<OfShape>::from_arg_matches(matches)?.values;
        let wrong =
            |problem: Problem| clap::Error::raw(clap::error::ErrorKind::ValueValidation, format!("{problem}\n"));
        Self::from_values(&given).map_err(wrong)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}
