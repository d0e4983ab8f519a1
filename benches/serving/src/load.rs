//! A closed loop, in which each session sends its next observation after the reply, and its times in numbers.

use std::time::{Duration, Instant};

use futures::future::try_join_all;
use gleaner_proto::v1::{Observation, Timings};
use serde::Serialize;

use crate::Result;
use crate::connection::Connection;

/// The measurements of all rounds.
#[derive(Default)]
pub struct Load {
    samples: Vec<Sample>,
    wall: Duration,
}

struct Sample {
    round_trip: Duration,
    timings: Option<Timings>,
}

/// A load in numbers; times in milliseconds.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    pub p50: f64,
    pub p99: f64,
    pub p999: f64,
    pub actions_per_second: f64,
    pub served: Option<Served>,
}

/// Numbers that require the timings of the server.
#[derive(Debug, Clone, Serialize)]
pub struct Served {
    /// The share of all round trips' time in which the model ran.
    pub model_share: f64,
    pub model_p50: f64,
    pub decode_p50: f64,
    pub queue_p50: f64,
    pub gather_p50: f64,
    /// Round trip without the model.
    pub extra_p50: f64,
    pub extra_p99: f64,
    pub mean_batch: f64,
}

impl Load {
    /// Adds one measurement: every connection for `slice` after a warm-up of a quarter of it.
    pub async fn add(&mut self, connections: &mut [Connection], scene: &[Observation], slice: Duration) -> Result<()> {
        let from = Instant::now() + slice / 4;
        let until = from + slice;
        let every = connections
            .iter_mut()
            .enumerate()
            .map(|(at, connection)| run_session(connection, scene, at, (from, until)));
        self.samples.extend(try_join_all(every).await?.into_iter().flatten());
        self.wall += slice;
        Ok(())
    }

    pub fn summary(&self) -> Summary {
        let round_trips = times(self.samples.iter().map(|sample| sample.round_trip));
        Summary {
            p50: quantile(&round_trips, 0.5),
            p99: quantile(&round_trips, 0.99),
            p999: quantile(&round_trips, 0.999),
            actions_per_second: count(round_trips.len()) / self.wall.as_secs_f64(),
            served: self.served(),
        }
    }

    fn served(&self) -> Option<Served> {
        let timed: Vec<(Duration, Timings)> =
            self.samples.iter().filter_map(|sample| Some((sample.round_trip, sample.timings?))).collect();
        let stage = |of: fn(&Timings) -> u64| times(timed.iter().map(|(_, timed)| Duration::from_micros(of(timed))));
        let model = stage(|timings| timings.model_us);
        let round_trips: f64 = timed.iter().map(|(round_trip, _)| milliseconds(*round_trip)).sum();
        let without = timed.iter().map(|(all, timed)| all.saturating_sub(Duration::from_micros(timed.model_us)));
        let extra = times(without);
        let batches: f64 = timed.iter().map(|(_, timings)| f64::from(timings.batch_size)).sum();
        (!timed.is_empty()).then(|| Served {
            model_share: model.iter().sum::<f64>() / round_trips,
            model_p50: quantile(&model, 0.5),
            decode_p50: quantile(&stage(|timings| timings.decode_us), 0.5),
            queue_p50: quantile(&stage(|timings| timings.queue_us), 0.5),
            gather_p50: quantile(&stage(|timings| timings.batch_us), 0.5),
            extra_p50: quantile(&extra, 0.5),
            extra_p99: quantile(&extra, 0.99),
            mean_batch: batches / count(timed.len()),
        })
    }
}

/// Runs a session; returns the requests that started within the time.
async fn run_session(
    connection: &mut Connection,
    scene: &[Observation],
    first: usize,
    (from, until): (Instant, Instant),
) -> Result<Vec<Sample>> {
    let mut samples = Vec::new();
    for observation in scene.iter().cycle().skip(first) {
        let begun = Instant::now();
        if begun >= until {
            break;
        }
        let reply = connection.act(observation).await?;
        if begun >= from {
            samples.push(Sample { round_trip: reply.round_trip, timings: reply.timings });
        }
    }
    Ok(samples)
}

/// Times in milliseconds, sorted.
pub fn times(all: impl Iterator<Item = Duration>) -> Vec<f64> {
    let mut times: Vec<f64> = all.map(milliseconds).collect();
    times.sort_by(f64::total_cmp);
    times
}

/// The quantile of sorted times: the smallest one that is not below this part of them. NaN without times.
pub fn quantile(sorted: &[f64], part: f64) -> f64 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a place in a list, not below 0")]
    let place = (count(sorted.len()) * part).ceil() as usize;
    sorted.get(place.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

fn count(all: usize) -> f64 {
    f64::from(u32::try_from(all).unwrap_or(u32::MAX))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn quantiles_are_measured_values() {
        let sorted = times((1..=1000).rev().map(Duration::from_millis));
        let [middle, tail, end] = [0.5, 0.99, 0.999].map(|part| quantile(&sorted, part));
        assert!((middle - 500.0).abs() < 1e-9 && (tail - 990.0).abs() < 1e-9 && (end - 999.0).abs() < 1e-9);
        assert!(quantile(&[], 0.5).is_nan());
        assert!((quantile(&[7.0], 0.999) - 7.0).abs() < f64::EPSILON);
    }

    #[test]
    fn time_outside_the_model_is_extra() {
        let timings = Timings { model_us: 600, batch_size: 2, decode_us: 50, ..Timings::default() };
        let sample = || Sample { round_trip: Duration::from_millis(1), timings: Some(timings) };
        let load = Load { samples: vec![sample(), sample()], wall: Duration::from_secs(1) };
        let summary = load.summary();
        let served = summary.served.unwrap();
        assert!((summary.actions_per_second - 2.0).abs() < 1e-9);
        assert!((served.model_share - 0.6).abs() < 1e-9 && (served.extra_p99 - 0.4).abs() < 1e-9);
        assert!((served.mean_batch - 2.0).abs() < 1e-9);
        let silent = Load { samples: vec![Sample { timings: None, ..sample() }], wall: Duration::from_secs(1) };
        assert!(silent.summary().served.is_none());
    }
}
