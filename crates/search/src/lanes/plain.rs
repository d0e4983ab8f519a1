//! The sums for any processor.

use super::{CODES, Lanes, MOST, PANELS, Panels, QUERIES, Query, Sums, WIDE};

pub(super) fn centre(row: &[f32], centre: &[Lanes<f32>], to: &mut [Lanes<f32>]) -> f32 {
    let mut largest = 0f32;
    for ((values, centre), to) in row.chunks(WIDE).zip(centre).zip(to) {
        *to = Lanes([0.0; WIDE]);
        for ((value, centre), to) in values.iter().zip(centre.0).zip(&mut to.0) {
            *to = value - centre;
            largest = largest.max(to.abs());
        }
    }
    largest
}

pub(super) fn code(values: &[Lanes<f32>], inverse: f32, codes: &mut [i32]) -> Sums {
    let mut sums = Sums { codes: 0.0, squares: 0.0, rests: 0.0 };
    for (four, to) in values.iter().flat_map(|values| values.0.as_chunks::<CODES>().0).zip(codes) {
        let bytes = four.map(|value| {
            let exact = value * inverse;
            let code = exact.round_ties_even().clamp(-MOST, MOST);
            sums.codes += code;
            sums.squares += code * code;
            sums.rests += (exact - code) * (exact - code);
            #[expect(clippy::cast_possible_truncation, reason = "at most 127 in size")]
            let byte = code as i8;
            byte
        });
        *to = i32::from_le_bytes(bytes.map(i8::cast_unsigned));
    }
    sums
}

pub(super) fn bounds(
    queries: &[Query<'_>; QUERIES],
    panels: &Panels<'_>,
    to: &mut [[Lanes<f32>; PANELS]; QUERIES],
) -> [u64; QUERIES] {
    std::array::from_fn(|at| {
        let query = &queries[at];
        let mut open = 0;
        for (panel, to) in to[at].iter_mut().enumerate().take(panels.count) {
            for lane in 0..WIDE {
                let (mut sum, mut from) = (0f32, 0);
                for part in 0..3 {
                    let until = from + panels.groups[part];
                    let corpus = panels.codes[panel * panels.all + from..panel * panels.all + until].iter();
                    let product = corpus.zip(&query.codes[from..until]).map(|(e, q)| product(e.0[lane], *q));
                    let terms = &query.terms[part];
                    #[expect(clippy::cast_precision_loss, reason = "the rounding is in the margin")]
                    let product = (terms.begin + product.sum::<i32>()) as f32;
                    let squares = panels.squares[panel * 3 + part].0[lane] + terms.square;
                    let value = terms.factor.mul_add(product, squares).max(0.0);
                    sum += if panels.roots { value.sqrt() } else { value };
                    from = until;
                }
                to.0[lane] = sum;
                open |= u64::from(sum <= query.limit) << (panel * WIDE + lane);
            }
        }
        open
    })
}

/// The sum of products of four unsigned bytes and four signed bytes.
fn product(point: i32, query: i32) -> i32 {
    let (point, query) = (point.to_le_bytes(), query.to_le_bytes().map(u8::cast_signed));
    point.iter().zip(query).map(|(e, q)| i32::from(*e) * i32::from(q)).sum()
}
