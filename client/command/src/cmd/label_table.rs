//! Options of a table of labels: which of its columns and words are those of labels.csv. Must not know a server.

use std::path::Path;

use clap::Args;
use gleaner_client::{ClientError, LabelTable, LabelledFile, read_table};

use crate::failure::{Failure, Result};
use crate::words;

#[derive(Args, Clone, Debug, Default)]
pub(super) struct LabelTableArgs {
    /// Columns of a table of your own in place of those of labels.csv, such as file=recording,cohort=trouble.
    #[arg(long, value_name = "file|task|outcome|cohort=COLUMN", value_delimiter = ',')]
    label_columns: Vec<String>,
    /// Word of a success in the outcomes of a table of your own, upper or lower case; may be repeated. Every other word is
    /// then a failure, and an empty cell an unknown outcome. Default: the words are success, failure and unknown.
    #[arg(long, value_name = "WORD")]
    success_value: Vec<String>,
}

impl LabelTableArgs {
    /// The rows of a labels file.
    ///
    /// # Errors
    /// As [`LabelTable::new`] and [`read_table`].
    pub(super) fn read(&self, file: &Path) -> Result<Vec<LabelledFile>> {
        let table = LabelTable::new(&self.label_columns, self.success_value.clone());
        let table = table.map_err(|problem| Failure::message(format!("--label-columns: {problem}")))?;
        read_table(file, &table).map_err(|error| match (error, self.given()) {
            (ClientError::Invalid(problem), None) => Failure::message(format!(
                "{problem}. For a table with other columns or words: --label-columns file=COLUMN,outcome=COLUMN and \
                 --success-value WORD"
            )),
            (error, _) => error.into(),
        })
    }

    /// The options as they were typed, each after a space.
    pub(super) fn typed(&self) -> String {
        let columns = (!self.label_columns.is_empty()).then(|| self.label_columns.join(","));
        let columns = columns.map(|columns| format!(" --label-columns {}", words::shell_word(&columns)));
        let successes = self.success_value.iter().map(|word| format!(" --success-value {}", words::shell_word(word)));
        columns.into_iter().chain(successes).collect()
    }

    /// The flag that was given, if one was.
    pub(super) fn given(&self) -> Option<&'static str> {
        let columns = (!self.label_columns.is_empty()).then_some("--label-columns");
        columns.or_else(|| (!self.success_value.is_empty()).then_some("--success-value"))
    }

    /// Refuses the options where there is no file of labels, rather than to ignore them. `flag` names such a file.
    ///
    /// # Errors
    /// An option that was given.
    pub(super) fn refuse(&self, flag: &str) -> Result<()> {
        match self.given() {
            None => Ok(()),
            Some(given) => Err(Failure::message(format!("{given} applies only to a file of labels: add {flag}"))),
        }
    }
}
