//! The nearest search beside what the tensor library does: the plain matrix product of the same
//! size, its roofline, and distances in tiles. Uses only the public interface.
//!
//! Arguments: queries (100000), indexed points (4000), values a part (128), how
//! many rows to check against a direct comparison in double precision (all). At the end, windows of
//! rows beside the same points with rows of their own.

#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]

use std::time::Instant;

use gleaner_search::{Distance, Index, Match, Metric, PARTS, PointShape, Points};
use tch::{Device, Kind, Tensor};

/// Every time is the best of this many, measured in turn, so that other load disturbs all alike.
const ROUNDS: usize = 3;
/// Rows of a tile for the library's distances; the fastest counts.
const TILES: [usize; 3] = [512, 2_048, 8_192];
/// Rows of a window, and values of its parts: two cameras of 8 × 8 RGBD pixels, a robot's joints, its actions.
const WINDOW: PointShape = PointShape { widths: [512, 38, 7], length: 7 };
/// One query in this many is nearly an indexed point.
const DUPLICATE: usize = 10;

/// A cheap stream of numbers that do not repeat.
struct Noise(u64);

impl Noise {
    fn bits(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        u32::try_from(self.0 >> 33).unwrap()
    }

    /// Between −1 and 1.
    fn next(&mut self) -> f32 {
        f32::from(u16::try_from(self.bits() >> 15).unwrap()) / 32_768.0 - 1.0
    }
}

/// Rows around a far-off mean. `Encoded`: as an encoder may give them, a few things happen and show
/// in all parts, each value has a little noise, neighbours in time are near each other.
/// `Scattered`: every value alone, where nothing helps to tell rows apart early.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Data {
    Encoded,
    Scattered,
}

fn features(data: Data, seed: u64, count: usize, width: usize) -> [Vec<f32>; 3] {
    const DIRECTIONS: usize = 16;
    [0u64, 1, 2].map(|part| {
        // The directions and the mean are the same for points and queries.
        let mut fixed = Noise(77 + part);
        let directions: Vec<f32> = (0..DIRECTIONS * width).map(|_| fixed.next()).collect();
        let mean: Vec<f32> = (0..width).map(|_| 3.0 * fixed.next()).collect();
        let (mut happening, mut noise) = (Noise(seed * 31), Noise(seed * 31 + 1 + part));
        let mut place = [0f32; DIRECTIONS];
        let mut all = Vec::with_capacity(count * width);
        for at in 0..count {
            let step = if at % 200 == 0 { 2.0 } else { 0.2 };
            place.iter_mut().for_each(|x| *x = (*x + step * happening.next()).clamp(-1.0, 1.0));
            for value in 0..width {
                let of_value = &directions[value * DIRECTIONS..(value + 1) * DIRECTIONS];
                let along: f32 = place.iter().zip(of_value).map(|(x, d)| x * d).sum();
                all.push(mean[value] + if data == Data::Encoded { along + 0.2 * noise.next() } else { noise.next() });
            }
        }
        all
    })
}

/// Makes some queries indexed points, exactly or but for the last bit of one value.
fn plant_duplicates(queries: &mut [Vec<f32>; 3], points: &[Vec<f32>; 3], width: usize) {
    let (count, many) = (queries[0].len() / width, points[0].len() / width);
    for query in (0..count).step_by(DUPLICATE) {
        let point = (query * 7) % many;
        for part in 0..3 {
            let row = &mut queries[part][query * width..(query + 1) * width];
            row.copy_from_slice(&points[part][point * width..(point + 1) * width]);
        }
        if query % (2 * DUPLICATE) == 0 {
            let value = &mut queries[query % 3][query * width];
            *value = value.next_up();
        }
    }
}

/// Sums kept side by side, so that none waits for another.
const SUMS: usize = 8;

/// Σ f(a, b), in double precision.
fn sum(a: &[f32], b: &[f32], f: impl Fn(f64, f64) -> f64) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<SUMS>(), b.as_chunks::<SUMS>());
    let mut sums = [0f64; SUMS];
    for (a, b) in a.iter().zip(b) {
        for i in 0..SUMS {
            sums[i] += f(f64::from(a[i]), f64::from(b[i]));
        }
    }
    let rest = a_rest.iter().zip(b_rest).map(|(a, b)| f(f64::from(*a), f64::from(*b)));
    sums.into_iter().chain(rest).sum()
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    sum(a, b, |a, b| a * b)
}

/// The winner of one query by a direct comparison in double precision: the first of the nearest.
/// `squares` has those of the points where distances are those of angles.
fn brute_force(points: &[Vec<f32>; 3], row: [&[f32]; 3], squares: Option<&[Vec<f64>; 3]>) -> (usize, f64) {
    let width = row[0].len();
    let own = row.map(|row| dot(row, row));
    let mut best = (0, f64::INFINITY);
    for point in 0..points[0].len() / width {
        let mut distance = 0.0;
        for (part, a) in row.iter().enumerate() {
            let b = &points[part][point * width..(point + 1) * width];
            distance += match squares {
                Some(squares) => 1.0 - dot(a, b) / (own[part] * squares[part][point]).sqrt(),
                None => sum(a, b, |a, b| (a - b) * (a - b)).sqrt(),
            };
        }
        if distance < best.1 {
            best = (point, distance);
        }
    }
    best
}

fn tensors(all: &[Vec<f32>; 3], width: usize) -> [Tensor; 3] {
    all.each_ref().map(|values| Tensor::from_slice(values).view([-1, int(width)]))
}

fn int(n: usize) -> i64 {
    i64::try_from(n).unwrap()
}

fn seconds(work: impl FnOnce()) -> f64 {
    let begin = Instant::now();
    work();
    begin.elapsed().as_secs_f64()
}

/// The same multiplications and additions as one matrix product per part, nothing else.
fn products(queries: &[Tensor; 3], points: &[Tensor; 3], out: &Tensor) {
    for (queries, points) in queries.iter().zip(points) {
        let _ = queries.mm_out(out, &points.tr());
    }
}

/// The library's distances in tiles, summed, and the least.
fn tiled_cdist(queries: &[Tensor; 3], points: &[Tensor; 3], tile: usize) -> Tensor {
    let least = |begin: i64| {
        let count = int(tile).min(queries[0].size()[0] - begin);
        let distance = |i: usize| Tensor::cdist(&queries[i].narrow(0, begin, count), &points[i], 2.0, None);
        let mut sum = distance(0);
        let _ = sum.g_add_(&distance(1)).g_add_(&distance(2));
        sum.min_dim(1, false).1
    };
    let tiles: Vec<Tensor> = (0..queries[0].size()[0]).step_by(tile).map(least).collect();
    Tensor::cat(&tiles, 0)
}

fn main() {
    // Whoever runs all benches passes `--bench`.
    let arguments: Vec<usize> = std::env::args().skip(1).filter_map(|argument| argument.parse().ok()).collect();
    let argument = |at: usize, default: usize| arguments.get(at).copied().unwrap_or(default);
    let (count, many, width) = (argument(0, 100_000), argument(1, 4_000), argument(2, 128));
    let checked = argument(3, count).min(count);
    println!("{count} queries x {many} points, 3 x {width} values, {} threads", tch::get_num_threads());
    for data in [Data::Encoded, Data::Scattered] {
        println!("{data:?}");
        measure(data, (count, many, width), checked);
    }
    measure_windows(count / 10, many);
}

/// An index of `many` windows, and the search for `count` of them.
fn measure_windows(count: usize, many: usize) {
    let windows = |seed: u64, count: usize| {
        let rows = [0, 1, 2]
            .map(|part: usize| std::mem::take(&mut features(Data::Encoded, seed, count, WINDOW.widths[part])[part]));
        let mut all = Points::empty(WINDOW);
        for first in (0..count).step_by(200) {
            let of = |part: usize, rows: &[f32]| {
                let width = WINDOW.widths[part];
                let own = &rows[first * width..rows.len().min((first + 200) * width)];
                [vec![0.0; (WINDOW.length - 1) * width], own.to_vec()].concat()
            };
            all.extend([0, 1, 2].map(|part: usize| of(part, &rows[part])));
        }
        all
    };
    let plain = |windows: &Points| {
        let of = |part: usize| (0..windows.count()).flat_map(|at| windows.row(part, at)).copied().collect();
        Points::new([of(0), of(1), of(2)], windows.widths()).unwrap()
    };
    let (points, queries) = (windows(1, many), windows(2, count));
    let both = [(&points, &queries), (&plain(&points), &plain(&queries))];
    let metric = Metric { kind: Distance::Euclidean, scale: [1.0; PARTS] };
    let (mut best, mut found) = ([f64::INFINITY; 2], [None, None]);
    for _ in 0..ROUNDS {
        for (i, (points, queries)) in both.iter().enumerate() {
            let search = || found[i] = Index::new(&[(0, points)], metric).unwrap().nearest(queries, None).unwrap();
            best[i] = best[i].min(seconds(search));
        }
    }
    let values = |points: &Points| (0..PARTS).map(|part| points.values(part).len()).sum::<usize>() / 250_000;
    println!("{} windows of {} rows, {} queries", points.count(), WINDOW.length, queries.count());
    println!("  search {:.3} s, with rows of their own {:.3} s", best[0], best[1]);
    println!("  the points' values: {} MB, with rows of their own {} MB", values(&points), values(both[1].0));
    println!("  {}", if found[0] == found[1] { "the same winners" } else { "OTHER WINNERS" });
}

fn measure(data: Data, (count, many, width): (usize, usize, usize), checked: usize) {
    let points = features(data, 1, many, width);
    let mut queries = features(data, 2, count, width);
    plant_duplicates(&mut queries, &points, width);
    let own = |values: &[Vec<f32>; 3]| Points::new(values.clone(), [width; 3]).unwrap();
    let more = own(&features(data, 3, (many / 100).max(1), width));
    let (own_points, own_queries) = (own(&points), own(&queries));
    let last_l2 = Metric { kind: Distance::Euclidean, scale: [1.0; 3] };
    let cosine = Metric { kind: Distance::Angular, scale: [1.0; 3] };
    compare_speed((&queries, &points, width), (&own_queries, &own_points, &more), last_l2);
    for (name, metric, angular) in [("last_l2", last_l2, false), ("last_cosine", cosine, true)] {
        let matches = Index::new(&[(0, &own_points)], metric).unwrap().nearest(&own_queries, None).unwrap().unwrap();
        check((&queries, &points, width), &matches, (name, checked, angular));
    }
}

fn compare_speed(
    (queries, points, width): (&[Vec<f32>; 3], &[Vec<f32>; 3], usize),
    (own_queries, own_points, more): (&Points, &Points, &Points),
    metric: Metric,
) {
    let (query_tensors, point_tensors) = (tensors(queries, width), tensors(points, width));
    let out = Tensor::zeros([int(own_queries.count()), int(own_points.count())], (Kind::Float, Device::Cpu));
    let mut best = [f64::INFINITY; 3];
    let mut cdist = [f64::INFINITY; TILES.len()];
    for _ in 0..ROUNDS {
        let mut matches: Vec<Option<Match>> = vec![None; own_queries.count()];
        let times = [
            seconds(|| products(&query_tensors, &point_tensors, &out)),
            seconds(|| {
                Index::new(&[(0, own_points)], metric).unwrap().improve(own_queries, None, &mut matches).unwrap()
            }),
            seconds(|| Index::new(&[(1, more)], metric).unwrap().improve(own_queries, None, &mut matches).unwrap()),
        ];
        best.iter_mut().zip(times).for_each(|(best, time)| *best = best.min(time));
        for (best, tile) in cdist.iter_mut().zip(TILES) {
            *best = best.min(seconds(|| drop(tiled_cdist(&query_tensors, &point_tensors, tile))));
        }
    }
    let [roofline, search, extension] = best;
    println!("  matrix products {roofline:.3} s, search {search:.3} s");
    println!("  cdist in tiles of {TILES:?} rows: {cdist:.3?} s");
    let cdist = cdist.into_iter().fold(f64::INFINITY, f64::min);
    println!("  search: {:.2} x tiled cdist, {:.2} x of the roofline", cdist / search, roofline / search);
    println!("  {} more points: {extension:.4} s, {:.2} % of a full search", more.count(), 100.0 * extension / search);
}

/// Prints how many winners are those of a direct comparison; where distances round to the same, any
/// of them.
fn check(
    (queries, points, width): (&[Vec<f32>; 3], &[Vec<f32>; 3], usize),
    matches: &[Match],
    (name, checked, angular): (&str, usize, bool),
) {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let every = matches.len().div_ceil(checked.max(1)).max(1);
    let rows: Vec<usize> = (0..matches.len()).step_by(every).collect();
    let squares = points.each_ref().map(|values| values.chunks(width).map(|row| dot(row, row)).collect());
    let squares: Option<&[Vec<f64>; 3]> = angular.then_some(&squares);
    let wrong: usize = std::thread::scope(|scope| {
        let part = |rows: &[usize]| {
            let differs = |query: &usize| {
                let row = queries.each_ref().map(|values| &values[query * width..(query + 1) * width]);
                let (point, distance) = brute_force(points, row, squares);
                let found = &matches[*query];
                found.row as usize != point && (found.distance - distance).abs() > 1e-14 * distance.max(1.0)
            };
            rows.iter().filter(|query| differs(query)).count()
        };
        let running: Vec<_> =
            rows.chunks(rows.len().div_ceil(threads)).map(|rows| scope.spawn(move || part(rows))).collect();
        running.into_iter().map(|thread| thread.join().unwrap()).sum()
    });
    println!("  {name}: {} of {} rows have the winner of a direct comparison", rows.len() - wrong, rows.len());
}
