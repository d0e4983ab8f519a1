//! Datasets of other programs in the child: what one holds, and its episodes as recordings.

use std::ops::Range;
use std::path::Path;

use gleaner_inspector::{Assumed, Converted, Described, Order, Verdict};

use super::{Inspector, basic_order, refusal};
use crate::failure::Result;

/// Episodes that a child has converted, each as a recording or with the reason why it cannot be used.
pub(crate) type ConvertedRun = Vec<std::result::Result<Converted, String>>;

impl Inspector {
    /// What a dataset of another program holds, or that the file is of another program, or why the path cannot be read.
    pub(crate) async fn describe(
        &self,
        dataset: &Path,
        assumed: &Assumed,
    ) -> Result<std::result::Result<Described, String>> {
        let folder = tempfile::tempdir()?;
        let order = Order { describe: true, ..assuming(basic_order(dataset, &folder, None)?, assumed) };
        Ok(self.verdict(&order).await?.and_then(|verdict| {
            if let Verdict::Described(described) = verdict { Ok(described) } else { Err(refusal(verdict)) }
        }))
    }

    /// Writes neighbouring episodes of a dataset of another program as recordings into the folder `out`: the first ones of
    /// these, and at least one, as `gleaner_inspector::run_file` names them. Returns why if the dataset cannot be read or
    /// the child dies.
    pub(crate) async fn convert(
        &self,
        dataset: &Path,
        assumed: &Assumed,
        episodes: Range<u64>,
        out: &Path,
    ) -> Result<std::result::Result<ConvertedRun, String>> {
        let folder = tempfile::tempdir()?;
        let basic = assuming(basic_order(dataset, &folder, None)?, assumed);
        let order = Order { convert: Some(episodes), frames: out.to_owned(), ..basic };
        Ok(self.verdict(&order).await?.and_then(|verdict| {
            if let Verdict::Converted(converted) = verdict { Ok(converted) } else { Err(refusal(verdict)) }
        }))
    }

    /// A program in its place.
    #[cfg(test)]
    pub(crate) fn of(program: std::path::PathBuf) -> Self {
        Self { program }
    }
}

/// The order with what a person states of the dataset.
fn assuming(order: Order, assumed: &Assumed) -> Order {
    let Assumed { rate_hz, success_column } = assumed.clone();
    Order { rate_hz, success_column, ..order }
}
