//! The filter's levels: how rows are seen so that a product of them is cheap, and the bounds that
//! follow from it. A level handles one tile at a time.

use tch::{Device, Kind, Tensor};

use crate::bound::{Framed, factor, finish, shrunk, squares};
use crate::corpus::Corpus;
use crate::directions::Directions;
use crate::tensor::int;

/// Points processed together; tiles are a multiple of it.
pub(crate) const GROUP: usize = 16;

/// Points transformed together, which bounds the memory for it.
const CHUNK: usize = 1024;

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
    part: usize,
    directions: Option<Directions>,
    /// `[N + GROUP, d]`: −2 × the factor × the points' rows; `None` where each tile makes its own, because windows overlap and
    /// would take many times the memory of their rows.
    many: Option<Tensor>,
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
    /// The level of `part` of the points under `view`; `None` if it would not pay off.
    pub(crate) fn new(corpus: &Corpus, view: View, part: usize) -> Option<Self> {
        let points = &corpus.points;
        let directions = match view {
            View::Along => Some(Directions::principal(points, &corpus.frame, part)?),
            View::Whole => None,
        };
        let factor = factor(&corpus.relative, part, directions.as_ref().map_or(1.0, |directions| directions.stretch));
        let count = points.count();
        let zeros = |width: usize| Tensor::zeros([int(count + GROUP), int(width)], (Kind::Float, Device::Cpu));
        let width = directions.as_ref().map_or(points.widths()[part], Directions::count);
        let stored = view == View::Along || points.shape().length == 1;
        let many = stored.then(|| zeros(width));
        let mut level = Self { directions, part, many, squares: zeros(1), factor, moved: 0.0 };
        for from in (0..count).step_by(CHUNK) {
            let size = CHUNK.min(count - from);
            let placed = level.place(&corpus.frame.apply(points, part, from..from + size));
            let of = |all: &Tensor| all.narrow(0, int(from), int(size));
            of(&level.squares).copy_(&placed.squares);
            if let Some(many) = &level.many {
                of(many).copy_(&(placed.rows * (-2.0 * factor)));
            }
            level.moved = level.moved.max(placed.moved);
        }
        level.squares = level.squares.tr().contiguous();
        Some(level)
    }

    /// −2 × the factor × the rows of `width` points from `from` on, `[width, d]`; zeros after the last.
    fn tile(&self, corpus: &Corpus, (from, width): (usize, usize)) -> Tensor {
        if let Some(many) = &self.many {
            return many.narrow(0, int(from), int(width));
        }
        let to = corpus.points.count().min(from + width);
        let tile = corpus.frame.rows(&corpus.points, self.part, from..to).g_mul_scalar_(-2.0 * self.factor);
        tile.constant_pad_nd([0, 0, 0, int(width - (to - from))])
    }

    /// A copy for another thread.
    pub(crate) fn share(&self) -> Self {
        Self {
            directions: self.directions.as_ref().map(Directions::share),
            many: self.many.as_ref().map(Tensor::shallow_clone),
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
    /// the points from `from` on, `[open, width]`. `buffer` has room for as many.
    pub(crate) fn bound(
        &self,
        (placed, open): (&Placed, Option<&Tensor>),
        (corpus, from): (&Corpus, usize),
        (sum, first): (&mut Tensor, bool),
        buffer: &Tensor,
    ) {
        let (count, width) = (sum.size()[0], sum.size()[1]);
        let tile = self.tile(corpus, (from, usize::try_from(width).unwrap_or_default())).tr();
        let chosen = |all: &Tensor| open.map_or_else(|| all.shallow_clone(), |open| all.index_select(0, open));
        let other = || buffer.narrow(0, 0, count * width).view([count, width]);
        let mut products = if first { sum.shallow_clone() } else { other() };
        let _ = chosen(&placed.rows).mm_out(&products, &tile);
        finish(
            corpus.relative.kind,
            &mut products,
            &self.squares.narrow(1, int(from), width),
            &chosen(&placed.squares),
        );
        if !first {
            let _ = sum.g_add_(&products);
        }
    }
}
