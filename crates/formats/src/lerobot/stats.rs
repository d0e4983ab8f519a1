//! Statistics of features: mean, deviation, range and quantiles, of an episode and of the dataset.
//!
//! Numbers are counted one by one; quantiles are of a sample at even distances once there are many. Pixels are counted in
//! histograms, so that they take the same memory for any number of pictures.

use serde_json::{Map, Value, json};

use super::features::{COLUMNS, Camera, Features};

const QUANTILES: [(&str, f64); 5] = [("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)];
/// The statistics of a feature, in the order of [`Summary::values`].
pub(super) const NAMES: [&str; 9] = ["min", "max", "mean", "std", "q01", "q10", "q50", "q90", "q99"];
/// Most rows of a feature of which quantiles are made.
const MOST_ROWS: usize = 1 << 16;

/// Statistics of every feature so far.
#[derive(Clone, Debug)]
pub(super) struct Stats {
    /// Vectors, then columns.
    numbers: Vec<(String, Series)>,
    images: Vec<(Camera, Vec<Histogram>, u64)>,
}

/// The statistics of one feature.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Summary {
    /// For each of [`NAMES`], a value for each number or channel.
    pub(super) values: [Vec<f64>; NAMES.len()],
    pub(super) count: u64,
}

impl Stats {
    pub(super) fn new(features: &Features) -> Self {
        let vectors = features.vectors().iter().map(|vector| (vector.name.to_owned(), Series::new(vector.size)));
        let columns = COLUMNS.iter().map(|(name, _)| ((*name).to_owned(), Series::new(1)));
        let histograms = |camera: &Camera| {
            let channel = if camera.depth { Histogram::new(1 << 16, 1.0) } else { Histogram::new(1 << 8, 255.0) };
            (camera.clone(), vec![channel; if camera.depth { 1 } else { 3 }], 0)
        };
        Self { numbers: vectors.chain(columns).collect(), images: features.cameras().iter().map(histograms).collect() }
    }

    /// Counts a frame: the numbers of each feature, in their order, and the pixels of its step if they were read.
    pub(super) fn add(&mut self, numbers: &[Vec<f64>], frames: &[u8]) {
        for ((_, series), numbers) in self.numbers.iter_mut().zip(numbers) {
            series.add(numbers);
        }
        if frames.is_empty() {
            return;
        }
        for (camera, channels, count) in &mut self.images {
            *count += 1;
            let pixels = camera.pixels(frames);
            if camera.depth {
                pixels.chunks_exact(2).for_each(|pixel| channels[0].add(u16::from_le_bytes([pixel[0], pixel[1]])));
            } else {
                for pixel in pixels.chunks_exact(3) {
                    channels.iter_mut().zip(pixel).for_each(|(channel, &value)| channel.add(value.into()));
                }
            }
        }
    }

    /// Each feature's statistics, and whether they are of pictures.
    pub(super) fn summaries(&self) -> Vec<(&str, Summary, bool)> {
        let numbers = self.numbers.iter().map(|(name, series)| (name.as_str(), series.summary(), false));
        let images = self.images.iter().map(|(camera, channels, count)| {
            let of: Vec<[f64; NAMES.len()]> = channels.iter().map(Histogram::summary).collect();
            let values = std::array::from_fn(|at| of.iter().map(|channel| channel[at]).collect());
            (camera.name.as_str(), Summary { values, count: *count }, true)
        });
        numbers.chain(images).collect()
    }

    pub(super) fn to_json(&self) -> Value {
        let mut features = Map::new();
        for (name, summary, image) in self.summaries() {
            let mut feature = Map::new();
            for (stat, values) in NAMES.iter().zip(&summary.values) {
                let nested = values.iter().map(|value| if image { json!([[value]]) } else { json!(value) });
                feature.insert((*stat).to_owned(), nested.collect());
            }
            feature.insert("count".to_owned(), json!([summary.count]));
            features.insert(name.to_owned(), Value::Object(feature));
        }
        Value::Object(features)
    }
}

/// The numbers of one feature.
#[derive(Clone, Debug)]
struct Series {
    count: u64,
    each: Vec<Moments>,
    /// Rows at even distances, row-major.
    sample: Vec<f64>,
    /// Distance of the sample's rows.
    stride: u64,
}

#[derive(Clone, Copy, Debug)]
struct Moments {
    mean: f64,
    squares: f64,
    min: f64,
    max: f64,
}

impl Series {
    fn new(size: usize) -> Self {
        let none = Moments { mean: 0.0, squares: 0.0, min: f64::INFINITY, max: f64::NEG_INFINITY };
        Self { count: 0, each: vec![none; size], sample: Vec::new(), stride: 1 }
    }

    fn add(&mut self, row: &[f64]) {
        let size = self.each.len().max(1);
        if self.count.is_multiple_of(self.stride) {
            if self.sample.len() / size >= MOST_ROWS {
                let kept = self.sample.chunks_exact(size).step_by(2).flatten().copied().collect();
                (self.sample, self.stride) = (kept, self.stride * 2);
            }
            if self.count.is_multiple_of(self.stride) {
                self.sample.extend_from_slice(row);
            }
        }
        self.count += 1;
        for (moments, &value) in self.each.iter_mut().zip(row) {
            // Welford's recurrence: no difference of large sums.
            let from_mean = value - moments.mean;
            moments.mean += from_mean / precise(self.count);
            moments.squares += from_mean * (value - moments.mean);
            moments.min = moments.min.min(value);
            moments.max = moments.max.max(value);
        }
    }

    fn summary(&self) -> Summary {
        let size = self.each.len();
        let of = |at: usize, moments: &Moments| {
            let mut sorted: Vec<f64> = self.sample.iter().skip(at).step_by(size.max(1)).copied().collect();
            sorted.sort_by(f64::total_cmp);
            let value = |rank: usize| sorted.get(rank).copied().unwrap_or_default();
            let std = (moments.squares / precise(self.count.max(1))).max(0.0).sqrt();
            summary([moments.min, moments.max, moments.mean, std], sorted.len(), value)
        };
        let of: Vec<_> = self.each.iter().enumerate().map(|(at, moments)| of(at, moments)).collect();
        Summary { values: std::array::from_fn(|at| of.iter().map(|one| one[at]).collect()), count: self.count }
    }
}

/// How often each value of a pixel's channel occurs.
#[derive(Clone, Debug)]
struct Histogram {
    counts: Vec<u64>,
    /// The value that is 1 in statistics.
    unit: f64,
}

impl Histogram {
    fn new(values: usize, unit: f64) -> Self {
        Self { counts: vec![0; values], unit }
    }

    fn add(&mut self, value: u16) {
        if let Some(count) = self.counts.get_mut(usize::from(value)) {
            *count += 1;
        }
    }

    fn summary(&self) -> [f64; NAMES.len()] {
        let total: u64 = self.counts.iter().sum();
        let found = || self.counts.iter().enumerate().filter(|(_, count)| **count > 0);
        let scaled = |value: usize| number(value) / self.unit;
        let mean = found().map(|(value, &count)| scaled(value) * precise(count)).sum::<f64>() / precise(total.max(1));
        let squares: f64 = found().map(|(value, &count)| (scaled(value) - mean).powi(2) * precise(count)).sum();
        let at = |rank: usize| {
            let mut before = 0;
            let here = found().find(|(_, count)| {
                before += **count;
                before > rank as u64
            });
            here.map_or(0.0, |(value, _)| scaled(value))
        };
        let (min, max) = (found().next(), found().next_back());
        let end = |found: Option<(usize, &u64)>| found.map_or(0.0, |(value, _)| scaled(value));
        let std = (squares / precise(total.max(1))).sqrt();
        summary([end(min), end(max), mean, std], usize::try_from(total).unwrap_or(usize::MAX), at)
    }
}

/// The statistics with quantiles of `count` values in their order, between neighbours by distance as numpy does.
fn summary(first: [f64; 4], count: usize, value: impl Fn(usize) -> f64) -> [f64; NAMES.len()] {
    let mut all = [0.0; NAMES.len()];
    all[..first.len()].copy_from_slice(&first);
    for (out, (_, quantile)) in all[first.len()..].iter_mut().zip(QUANTILES) {
        let place = quantile * number(count.saturating_sub(1));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and the count")]
        let low = place.floor() as usize;
        let (below, above) = (value(low), value((low + 1).min(count.saturating_sub(1))));
        *out = below + (above - below) * place.fract();
    }
    all
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn precise(count: u64) -> f64 {
    count as f64
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn number(count: usize) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_numbers_are_those_of_numpy() {
        let mut series = Series::new(2);
        for row in [[1.0, -1.0], [2.0, 0.0], [4.0, 0.0], [8.0, 5.0]] {
            series.add(&row);
        }
        let Summary { values, count } = series.summary();
        assert_eq!(count, 4);
        let column: Vec<f64> = values.iter().map(|stat| stat[0]).collect();
        // numpy: min, max, mean, std, quantile of [1, 2, 4, 8].
        let expected = [1.0, 8.0, 3.75, 2.680_951_323_690_902, 1.03, 1.3, 3.0, 6.8, 7.88];
        assert!(column.iter().zip(expected).all(|(found, wanted)| (found - wanted).abs() < 1e-12), "{column:?}");
        assert_eq!(values[1][1], 5.0);
    }

    #[test]
    fn statistics_of_pixels_are_those_of_their_values() {
        let mut histogram = Histogram::new(256, 255.0);
        [0, 51, 51, 255].into_iter().for_each(|value| histogram.add(value));
        let found = histogram.summary();
        let expected = [0.0, 1.0, 0.35, 0.384_057_287_393_432_5, 0.006, 0.06, 0.2, 0.76, 0.976];
        assert!(found.iter().zip(expected).all(|(found, wanted)| (found - wanted).abs() < 1e-12), "{found:?}");
    }

    #[test]
    fn a_long_series_is_sampled_at_even_distances() {
        let mut series = Series::new(1);
        let rows = u32::try_from(MOST_ROWS).unwrap() * 5;
        (0..rows).for_each(|row| series.add(&[f64::from(row)]));
        assert!(series.sample.len() <= MOST_ROWS);
        assert!(series.sample.windows(2).all(|pair| pair[1] - pair[0] == 8.0));
        let median = series.summary().values[6][0];
        assert!((median / f64::from(rows) - 0.5).abs() < 1e-3, "{median}");
    }
}
