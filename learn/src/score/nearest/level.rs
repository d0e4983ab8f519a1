//! The filter's levels: how rows are seen so that a product of them is cheap, and the bounds that
//! follow from it. Knows one tile at a time.

use tch::{Kind, Tensor};

use super::bound::{Framed, factor, finish, shrunk, squares};
use super::directions::Directions;
use crate::batch::int;
use crate::score::similarity::Metric;

/// Segments looked at together; tiles are a multiple of it.
pub(super) const GROUP: usize = 16;
/// The largest code of a value.
const CODES: f64 = 127.0;
/// Wider rows could overflow the sums of codes' products, and their squares single precision.
const MOST_CODED: usize = 1024;
/// So that its inverse is finite.
const LEAST_STEP: f64 = 1e-32;

/// How a level sees rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum View {
    /// As they are.
    Whole,
    /// Along few directions: pays where experts differ along few.
    Along,
    /// Every value as one of 255 multiples of a step. Products of such codes are exact, and four
    /// times as fast where the processor has an instruction for them. Distances change by no more
    /// than the rounding to a step moved the rows: little, whatever the data.
    Coded,
}

impl View {
    /// The cheapest first; codes only where their products are both exact and fast.
    pub(super) fn all() -> Vec<Self> {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx512vnni") {
            return vec![Self::Along, Self::Coded, Self::Whole];
        }
        vec![Self::Along, Self::Whole]
    }
}

/// One modality of the experts on one level.
pub(super) struct Level {
    directions: Option<Directions>,
    /// `[N + GROUP, d]`: −2 × the factor × the experts' rows, or their codes.
    many: Tensor,
    /// `[1, N + GROUP]`: what to add to the products.
    squares: Tensor,
    /// What squared distances are multiplied by.
    factor: f64,
    /// Of the codes; 0 where rows are not coded.
    step: f64,
    /// The most that bringing a segment here may have moved it.
    pub(super) moved: f64,
}

/// One modality of some queries on one level.
pub(super) struct Placed {
    /// `[count, d]`, values or codes.
    rows: Tensor,
    /// `[count, 1]`: what to add to the products.
    squares: Tensor,
    step: f64,
    pub(super) moved: f64,
}

/// Where a tile's products are written.
pub(super) struct Buffers {
    single: Tensor,
    codes: Tensor,
}

impl Level {
    /// How `view` sees `framed`; `None` if that would not pay.
    pub(super) fn new(framed: &Framed, view: View, (metric, modality): (&Metric, usize)) -> Option<Self> {
        let directions = if view == View::Along { Some(Directions::principal(framed)?) } else { None };
        if view == View::Coded && (framed.width() > MOST_CODED || framed.count() == 0) {
            return None;
        }
        let factor = factor(metric, modality, directions.as_ref().map_or(1.0, |directions| directions.stretch));
        let mut level = Self {
            directions,
            many: Tensor::new(),
            squares: Tensor::new(),
            factor,
            step: f64::from(u8::from(view == View::Coded)),
            moved: 0.0,
        };
        let placed = level.place(framed);
        let padded = |all: &Tensor, scale: f64| {
            let mut padding = all.size();
            padding[0] = int(GROUP);
            let all = if scale == 1.0 { all.shallow_clone() } else { all * scale };
            Tensor::cat(&[&all, &Tensor::zeros(padding, (all.kind(), all.device()))], 0).contiguous()
        };
        level.many = padded(&placed.rows, if view == View::Coded { 1.0 } else { -2.0 * factor });
        level.squares = padded(&placed.squares, 1.0).tr().contiguous();
        (level.step, level.moved) = (placed.step, placed.moved);
        Some(level)
    }

    /// The same for another thread.
    pub(super) fn share(&self) -> Self {
        Self {
            directions: self.directions.as_ref().map(Directions::share),
            many: self.many.shallow_clone(),
            squares: self.squares.shallow_clone(),
            ..*self
        }
    }

    /// Whether it says anything.
    pub(super) fn counts(&self) -> bool {
        self.factor > 0.0
    }

    /// Queries as this level sees them.
    pub(super) fn place(&self, framed: &Framed) -> Placed {
        if self.step > 0.0 {
            return self.code(framed);
        }
        let along = self.directions.as_ref().map(|directions| directions.apply(framed));
        let placed = along.as_ref().unwrap_or(framed);
        Placed {
            rows: placed.rows.shallow_clone(),
            squares: shrunk(&squares(&placed.rows), placed.width(), self.factor).unsqueeze(1),
            step: 0.0,
            moved: placed.moved,
        }
    }

    fn code(&self, framed: &Framed) -> Placed {
        let step = (framed.largest / CODES).max(LEAST_STEP);
        let rounded = (&framed.rows * (1.0 / step)).round_();
        let squares = shrunk(&squares(&rounded), framed.width(), self.factor * step * step).unsqueeze(1);
        // Every value is off by half a step, and a little for dividing in single precision.
        #[expect(clippy::cast_precision_loss, reason = "a feature's width is small")]
        let moved = framed.moved + 0.5001 * step * (framed.width() as f64).sqrt();
        Placed { rows: rounded.to_kind(Kind::Int8), squares, step, moved }
    }

    /// Adds to `sum` (or begins it with) this modality's lower bounds of the distances of `placed`,
    /// only those rows that are `open`, to the segments from `from` on: `[open, width]`.
    pub(super) fn bound(
        &self,
        (placed, open): (&Placed, Option<&Tensor>),
        from: usize,
        (sum, first): (&mut Tensor, bool),
        (metric, buffers): (&Metric, &Buffers),
    ) {
        let (count, width) = (sum.size()[0], sum.size()[1]);
        let tile = self.many.narrow(0, int(from), width).tr();
        let chosen = |all: &Tensor| open.map_or_else(|| all.shallow_clone(), |open| all.index_select(0, open));
        let view = |buffer: &Tensor| buffer.narrow(0, 0, count * width).view([count, width]);
        let mut products = if first { sum.shallow_clone() } else { view(&buffers.single) };
        if self.step > 0.0 {
            let codes = view(&buffers.codes);
            let _ = chosen(&placed.rows).internal_int_mm_out(&codes, &tile);
            products.copy_(&codes);
            let _ = products.g_mul_scalar_(-2.0 * self.factor * self.step * placed.step);
        } else {
            let _ = chosen(&placed.rows).mm_out(&products, &tile);
        }
        finish(metric.kind, &mut products, &self.squares.narrow(1, int(from), width), &chosen(&placed.squares));
        if !first {
            let _ = sum.g_add_(&products);
        }
    }
}

impl Buffers {
    /// For tiles of `size` pairs.
    pub(super) fn new(size: usize) -> Self {
        let empty = |kind: Kind| Tensor::zeros([int(size)], (kind, tch::Device::Cpu));
        Self { single: empty(Kind::Float), codes: empty(Kind::Int) }
    }
}
