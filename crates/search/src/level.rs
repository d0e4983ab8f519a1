//! The filter's levels: how rows are seen so that a product of them is cheap, and the bounds that
//! follow from it. A level handles one tile at a time.

use tch::Tensor;

use crate::bound::{Framed, factor, finish, shrunk, squares};
use crate::directions::Directions;
use crate::metric::Metric;
use crate::tensor::int;

/// Points processed together; tiles are a multiple of it.
pub(crate) const GROUP: usize = 16;

/// The view of rows on a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum View {
    /// Unchanged.
    Whole,
    /// Projected onto few directions: pays off where points differ along few.
    Along,
}

/// One part of the points on one level.
pub(crate) struct Level {
    directions: Option<Directions>,
    /// `[N + GROUP, d]`: −2 × the factor × the points' rows.
    many: Tensor,
    /// `[1, N + GROUP]`: summands of the products.
    squares: Tensor,
    /// Factor of squared distances.
    factor: f64,
    /// Longest distance by which the transformation may have moved a point.
    pub(crate) moved: f64,
}

/// One part of some queries on one level.
pub(crate) struct Placed {
    /// `[count, d]`.
    rows: Tensor,
    /// `[count, 1]`: summands of the products.
    squares: Tensor,
    pub(crate) moved: f64,
}

impl Level {
    /// The level of `framed` under `view`; `None` if it would not pay off.
    pub(crate) fn new(framed: &Framed, view: View, (metric, part): (&Metric, usize)) -> Option<Self> {
        let directions = if view == View::Along { Some(Directions::principal(framed)?) } else { None };
        let factor = factor(metric, part, directions.as_ref().map_or(1.0, |directions| directions.stretch));
        let mut level = Self { directions, many: Tensor::new(), squares: Tensor::new(), factor, moved: 0.0 };
        let placed = level.place(framed);
        let padded = |all: &Tensor, scale: f64| {
            let mut padding = all.size();
            padding[0] = int(GROUP);
            let all = if scale == 1.0 { all.shallow_clone() } else { all * scale };
            Tensor::cat(&[&all, &Tensor::zeros(padding, (all.kind(), all.device()))], 0).contiguous()
        };
        level.many = padded(&placed.rows, -2.0 * factor);
        level.squares = padded(&placed.squares, 1.0).tr().contiguous();
        level.moved = placed.moved;
        Some(level)
    }

    /// A copy for another thread.
    pub(crate) fn share(&self) -> Self {
        Self {
            directions: self.directions.as_ref().map(Directions::share),
            many: self.many.shallow_clone(),
            squares: self.squares.shallow_clone(),
            ..*self
        }
    }

    /// Whether the level contributes to bounds: with a factor of 0 its bounds are all 0.
    pub(crate) fn counts(&self) -> bool {
        self.factor > 0.0
    }

    /// Queries on this level.
    pub(crate) fn place(&self, framed: &Framed) -> Placed {
        let along = self.directions.as_ref().map(|directions| directions.apply(framed));
        let placed = along.as_ref().unwrap_or(framed);
        Placed {
            rows: placed.rows.shallow_clone(),
            squares: shrunk(&squares(&placed.rows), placed.width(), self.factor).unsqueeze(1),
            moved: placed.moved,
        }
    }

    /// Adds this part's lower bounds to `sum`, or starts it with them: the distances of the `open` rows of `placed` to
    /// the points from `from` on, `[open, width]`.
    pub(crate) fn bound(
        &self,
        (placed, open): (&Placed, Option<&Tensor>),
        from: usize,
        (sum, first): (&mut Tensor, bool),
        (metric, buffer): (&Metric, &Tensor),
    ) {
        let (count, width) = (sum.size()[0], sum.size()[1]);
        let tile = self.many.narrow(0, int(from), width).tr();
        let chosen = |all: &Tensor| open.map_or_else(|| all.shallow_clone(), |open| all.index_select(0, open));
        let other = || buffer.narrow(0, 0, count * width).view([count, width]);
        let mut products = if first { sum.shallow_clone() } else { other() };
        let _ = chosen(&placed.rows).mm_out(&products, &tile);
        finish(metric.kind, &mut products, &self.squares.narrow(1, int(from), width), &chosen(&placed.squares));
        if !first {
            let _ = sum.g_add_(&products);
        }
    }
}
