//! The part of a batch that one process works on. Every process draws the whole batch, so that its random numbers do not
//! depend on the number of processes. Independent of the content of a batch.

use std::collections::HashMap;
use std::ops::Range;

use super::{Segment, Windows};

/// Which part of every batch a process works on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Part {
    rank: usize,
    ranks: usize,
}

impl Part {
    /// All of it.
    pub(crate) const WHOLE: Self = Self { rank: 0, ranks: 1 };

    /// That of rank `rank` of `ranks`.
    pub(crate) fn of(rank: u32, ranks: u32) -> Self {
        Self { rank: rank as usize, ranks: ranks as usize }
    }

    /// The places of this part among `count`: neighbours, so that they share frames.
    fn range(self, count: usize) -> Range<usize> {
        count * self.rank / self.ranks..count * (self.rank + 1) / self.ranks
    }
}

/// The segments of a whole batch, and the part of them that is wanted.
#[derive(Clone, Copy)]
pub(crate) struct Drawn<'a> {
    /// Of the whole batch.
    pub(crate) segments: &'a [Segment],
    /// Whether the past of each one's window is hidden, so that its steps are not needed; empty if that of none is.
    pub(crate) alone: &'a [bool],
    /// Which of them are wanted.
    pub(crate) part: Part,
}

/// The whole batch, for which random numbers are drawn, and the place of a part in it.
pub(crate) struct Whole {
    /// The episode of each step of the whole batch, an index into the data.
    pub(crate) episodes: Vec<usize>,
    /// The part's steps among them; `None` if the part is all of it.
    pub(crate) rows: Option<Vec<i64>>,
    /// Whether each place of each window of the whole batch is inside the episode, row-major.
    pub(crate) valid_places: Vec<bool>,
    /// The part's windows among those of the whole batch.
    pub(crate) windows: Range<usize>,
    /// The number of windows of the whole batch.
    pub(crate) count: usize,
}

impl Whole {
    /// The part that is wanted and its layout: also returns the (episode, step) of its steps.
    pub(super) fn lay_out(
        Drawn { segments, alone, part }: Drawn<'_>,
        length: usize,
        device: tch::Device,
    ) -> (Self, Windows, Vec<(usize, usize)>) {
        let range = part.range(segments.len());
        let own = Windows::places(&segments[range.clone()], alone.get(range.clone()).unwrap_or_default(), length);
        let (windows, steps) = Windows::from_places(own, length, device);
        let all = (part != Part::WHOLE).then(|| Windows::places(segments, alone, length));
        let (valid_places, drawn) = match &all {
            Some(all) => (all.valid_places.clone(), &all.steps),
            None => (windows.valid_places.clone(), &steps),
        };
        let rows = all.is_some().then(|| {
            let places: HashMap<_, i64> = drawn.iter().zip(0..).map(|(step, row)| (*step, row)).collect();
            steps.iter().filter_map(|step| places.get(step).copied()).collect()
        });
        let episodes = drawn.iter().map(|(trajectory, _)| *trajectory).collect();
        (Self { episodes, rows, valid_places, windows: range, count: segments.len() }, windows, steps)
    }

    /// The part's windows as a share of the whole batch's.
    pub(crate) fn share_of_windows(&self) -> f64 {
        share(self.windows.len(), self.count)
    }

    /// The part's valid places as a share of the whole batch's.
    pub(crate) fn share_of_places(&self, length: usize) -> f64 {
        let valid = |places: &[bool]| places.iter().filter(|valid| **valid).count();
        share(
            valid(&self.valid_places[self.windows.start * length..self.windows.end * length]),
            valid(&self.valid_places),
        )
    }

    /// Values drawn for the steps of the whole batch `[N, …]`, those of the part's steps.
    pub(crate) fn of_steps(&self, drawn: tch::Tensor) -> tch::Tensor {
        let Some(rows) = &self.rows else { return drawn };
        drawn.index_select(0, &tch::Tensor::from_slice(rows).to_device(drawn.device()))
    }

    /// As [`Whole::of_steps`], for plain values.
    pub(crate) fn values_of_steps<T: Copy>(&self, drawn: Vec<T>) -> Vec<T> {
        let Some(rows) = &self.rows else { return drawn };
        rows.iter().filter_map(|row| drawn.get(usize::try_from(*row).ok()?).copied()).collect()
    }
}

fn share(part: usize, whole: usize) -> f64 {
    if part == whole {
        return 1.0;
    }
    #[expect(clippy::cast_precision_loss, reason = "counts of a batch")]
    let share = part as f64 / whole as f64;
    share
}
