//! The results of the processor's instructions equal those of the plain code.

use rand::RngExt;

use super::*;
use crate::testing::generator;

fn random(seed: u64, count: usize, size: f32) -> Vec<f32> {
    let mut rng = generator(seed, 14);
    (0..count).map(|_| size * rng.random_range(-1.0f32..1.0)).collect()
}

fn padded(values: &[f32]) -> Vec<Lanes<f32>> {
    values.chunks(WIDE).map(|some| Lanes(std::array::from_fn(|i| some.get(i).copied().unwrap_or(0.0)))).collect()
}

#[test]
fn rows_are_centred_and_coded_alike() {
    for width in [1, 4, 15, 16, 17, 128, 1000] {
        let (row, middle) = (random(1, width, 5.0), padded(&random(2, width, 2.0)));
        let mut placed = [padded(&row), padded(&row)];
        let largest = plain::centre(&row, &middle, &mut placed[0]);
        assert_eq!(centre(&row, &middle, &mut placed[1]), largest);
        assert_eq!(placed[0].iter().flat_map(|p| p.0).fold(0.0, |a: f32, b| a.max(b.abs())), largest);
        let mut codes = [vec![7; middle.len() * 4], vec![9; middle.len() * 4]];
        let sums = plain::code(&placed[0], MOST / largest, &mut codes[0]);
        let found = code(&placed[1], MOST / largest, &mut codes[1]);
        assert_eq!(codes[0], codes[1]);
        assert_eq!((found.codes, found.squares), (sums.codes, sums.squares));
        assert!((found.rests - sums.rests).abs() <= 1e-4 * sums.rests);
        let bytes = codes[0].iter().flat_map(|four| four.to_le_bytes()).map(u8::cast_signed);
        for (value, byte) in placed[0].iter().flat_map(|p| p.0).zip(bytes) {
            assert!((value * MOST / largest - f32::from(byte)).abs() < 0.5001);
        }
    }
}

#[test]
fn bounds_are_alike() {
    let mut rng = generator(3, 15);
    let (groups, all) = ([4, 8, 32], 44);
    let codes: Vec<Lanes<i32>> = (0..PANELS * all).map(|_| Lanes(std::array::from_fn(|_| rng.random()))).collect();
    let squares: Vec<Lanes<f32>> =
        (0..PANELS * 3).map(|_| Lanes(std::array::from_fn(|_| rng.random_range(0.0..3e5)))).collect();
    let rows: Vec<i32> = (0..QUERIES * all).map(|_| rng.random()).collect();
    let mut term = || Terms { begin: rng.random_range(-9..9), factor: -0.3, square: rng.random_range(0.0..3e5) };
    let terms: [[Terms; 3]; QUERIES] = std::array::from_fn(|_| [term(), term(), term()]);
    let query = |q: usize, limit| Query { codes: &rows[q * all..][..all], terms: &terms[q], limit };
    for (count, roots) in [(1, true), (2, true), (3, false), (4, true), (4, false)] {
        let panels = Panels { codes: &codes, squares: &squares, groups, all, count, roots };
        let mut found = [[[Lanes([-1f32; WIDE]); PANELS]; QUERIES]; 2];
        let with = |limit| [query(0, limit), query(1, limit), query(2, limit), query(3, limit)];
        let all_open = plain::bounds(&with(f32::INFINITY), &panels, &mut found[0]);
        assert!(all_open.iter().all(|open| *open == u64::MAX >> (64 - 16 * count)));
        let queries = with(found[0][2][0].0[7]);
        let open = plain::bounds(&queries, &panels, &mut found[0]);
        assert_eq!(bounds(&queries, &panels, &mut found[1]), open);
        let [plain, fast] = found.map(|all| all.map(|of_query| of_query.map(|panel| panel.0)));
        assert_eq!(plain, fast);
        assert!(open[2] & 1 << 7 != 0 && open != all_open);
    }
}
