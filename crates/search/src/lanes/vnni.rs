//! The sums with the instructions that multiply bytes. Safe, because the caller has checked for them.

use std::arch::x86_64::{
    __m512, __m512i, _CMP_LE_OQ, _mm512_abs_ps, _mm512_add_ps, _mm512_castps_si512, _mm512_cmp_ps_mask,
    _mm512_cvtepi32_epi8, _mm512_cvtepi32_ps, _mm512_dpbusd_epi32, _mm512_fmadd_ps, _mm512_max_ps, _mm512_mul_ps,
    _mm512_reduce_add_ps, _mm512_reduce_max_ps, _mm512_set1_epi32, _mm512_set1_ps, _mm512_setzero_ps,
    _mm512_setzero_si512, _mm512_sqrt_ps, _mm512_sub_ps,
};

use bytemuck::must_cast;

use super::{CODES, Lanes, PANELS, Panels, QUERIES, Query, Sums, Terms, WIDE};

/// Adding this to a small value rounds it to a whole number, which is then in the lowest bits.
const ROUND: f32 = 12_582_912.0;
/// Panels processed together: as many as the registers allow.
const SIDE: usize = 2;

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vnni")]
pub(super) fn centre(row: &[f32], centre: &[Lanes<f32>], to: &mut [Lanes<f32>]) -> f32 {
    let (whole, rest) = row.as_chunks::<WIDE>();
    let mut padded = [0f32; WIDE];
    padded[..rest.len()].copy_from_slice(rest);
    let last = (!rest.is_empty()).then_some(&padded);
    let mut largest = _mm512_setzero_ps();
    for ((values, centre), to) in whole.iter().chain(last).zip(centre).zip(to) {
        let placed = _mm512_sub_ps(must_cast(*values), must_cast(centre.0));
        largest = _mm512_max_ps(largest, _mm512_abs_ps(placed));
        to.0 = must_cast(placed);
    }
    _mm512_reduce_max_ps(largest)
}

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vnni")]
pub(super) fn code(values: &[Lanes<f32>], inverse: f32, codes: &mut [i32]) -> Sums {
    let (inverse, round) = (_mm512_set1_ps(inverse), _mm512_set1_ps(ROUND));
    let [mut sum, mut squares, mut rests] = [_mm512_setzero_ps(); 3];
    for (values, to) in values.iter().zip(codes.as_chunks_mut::<CODES>().0) {
        let exact = _mm512_mul_ps(must_cast(values.0), inverse);
        let rounded = _mm512_add_ps(exact, round);
        let code = _mm512_sub_ps(rounded, round);
        let rest = _mm512_sub_ps(exact, code);
        sum = _mm512_add_ps(sum, code);
        squares = _mm512_fmadd_ps(code, code, squares);
        rests = _mm512_fmadd_ps(rest, rest, rests);
        *to = must_cast(_mm512_cvtepi32_epi8(_mm512_castps_si512(rounded)));
    }
    Sums {
        codes: _mm512_reduce_add_ps(sum),
        squares: _mm512_reduce_add_ps(squares),
        rests: _mm512_reduce_add_ps(rests),
    }
}

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vnni")]
pub(super) fn bounds(
    queries: &[Query<'_>; QUERIES],
    panels: &Panels<'_>,
    to: &mut [[Lanes<f32>; PANELS]; QUERIES],
) -> [u64; QUERIES] {
    let mut open = [0; QUERIES];
    let mut panel = 0;
    while panel + SIDE <= panels.count {
        some::<SIDE>(queries, panels, (panel, to), &mut open);
        panel += SIDE;
    }
    if panel < panels.count {
        some::<1>(queries, panels, (panel, to), &mut open);
    }
    open
}

/// `P` panels, starting at `panel`.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vnni")]
#[inline]
fn some<const P: usize>(
    queries: &[Query<'_>; QUERIES],
    panels: &Panels<'_>,
    (panel, to): (usize, &mut [[Lanes<f32>; PANELS]; QUERIES]),
    open: &mut [u64; QUERIES],
) {
    let mut sums = [[_mm512_setzero_ps(); P]; QUERIES];
    let (first, last) = (panel * panels.all, (panel + P - 1) * panels.all);
    let mut from = 0;
    for part in 0..3 {
        let until = from + panels.groups[part];
        // A single panel is its own neighbour.
        let corpus = [&panels.codes[first + from..first + until], &panels.codes[last + from..last + until]];
        let [a, b, c, d] = queries;
        let codes = [&a.codes[from..until], &b.codes[from..until], &c.codes[from..until], &d.codes[from..until]];
        let mut products = [[_mm512_setzero_si512(); P]; QUERIES];
        for q in 0..QUERIES {
            products[q] = [_mm512_set1_epi32(queries[q].terms[part].begin); P];
        }
        multiply(codes, corpus, &mut products);
        for p in 0..P {
            let squares = must_cast(panels.squares[(panel + p) * 3 + part].0);
            for q in 0..QUERIES {
                let value = value(products[q][p], squares, &queries[q].terms[part]);
                let value = if panels.roots { _mm512_sqrt_ps(value) } else { value };
                sums[q][p] = _mm512_add_ps(sums[q][p], value);
            }
        }
        from = until;
    }
    for q in 0..QUERIES {
        let limit = _mm512_set1_ps(queries[q].limit);
        for p in 0..P {
            let near = _mm512_cmp_ps_mask::<_CMP_LE_OQ>(sums[q][p], limit);
            open[q] |= u64::from(near) << ((panel + p) * WIDE);
            to[q][panel + p].0 = must_cast(sums[q][p]);
        }
    }
}

/// Adds the products of one part's codes to `products`.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vnni")]
#[inline]
fn multiply<const P: usize>(
    [a, b, c, d]: [&[i32]; QUERIES],
    [first, last]: [&[Lanes<i32>]; SIDE],
    products: &mut [[__m512i; P]; QUERIES],
) {
    let mut sums = *products;
    let queries = a.iter().zip(b).zip(c.iter().zip(d));
    for ((first, last), ((a, b), (c, d))) in first.iter().zip(last).zip(queries) {
        let corpus: [__m512i; SIDE] = [must_cast(first.0), must_cast(last.0)];
        let queries = [*a, *b, *c, *d];
        for q in 0..QUERIES {
            let codes = _mm512_set1_epi32(queries[q]);
            for p in 0..P {
                sums[q][p] = _mm512_dpbusd_epi32(sums[q][p], corpus[p], codes);
            }
        }
    }
    *products = sums;
}

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vnni")]
#[inline]
fn value(product: __m512i, squares: __m512, terms: &Terms) -> __m512 {
    let squares = _mm512_add_ps(squares, _mm512_set1_ps(terms.square));
    let value = _mm512_fmadd_ps(_mm512_set1_ps(terms.factor), _mm512_cvtepi32_ps(product), squares);
    _mm512_max_ps(value, _mm512_setzero_ps())
}
