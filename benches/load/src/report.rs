//! Results of the load test: times of every kind of call in every phase, and targets, as tables and as JSON.
#![expect(clippy::print_stdout, reason = "a command's output")]

use std::path::Path;

use comfy_table::{Table, presets::ASCII_MARKDOWN};
use gleaner_bench_serving::{
    Result,
    targets::{Bound, Targets, time},
};
use serde::Serialize;

use crate::cli::Options;
use crate::hostile::Held;
use crate::stats::{CallKind, Phase, Stats};

/// The largest growth of memory after a fifth of the time, in percent.
const GROWTH: f64 = 5.0;
/// The 99th percentile of a query while uploads run, in milliseconds.
const QUERY: f64 = 50.0;
/// The largest ratio of 99th percentiles with and without a hostile client.
const HOSTILE: f64 = 1.2;
/// The largest ratio of a robot's 99th percentiles with and without held connections.
const HELD_RATIO: f64 = 2.0;
/// The longest life of an unused connection or a slow upload, in seconds.
const LONGEST_HELD: f64 = 10.0;

/// The results.
#[derive(Serialize)]
pub struct Report {
    options: Options,
    rows: Vec<Row>,
    /// Bytes, one number a second while all clients are at work.
    memory: Vec<u64>,
    held: Held,
    /// The flood's calls that received a response, rejections included.
    flood: u64,
    limited: u64,
    failed: u64,
    reasons: Vec<String>,
    targets: Targets,
}

/// Times in milliseconds.
#[derive(Serialize)]
struct Row {
    kind: String,
    phase: String,
    calls: usize,
    p50: f64,
    p99: f64,
}

impl Report {
    pub(crate) fn new(options: &Options, stats: &Stats, memory: Vec<u64>, (held, flood): (Held, u64)) -> Self {
        let (limited, failed, reasons) = stats.failures();
        let mut rows = Vec::new();
        for phase in [Phase::Alone, Phase::Load, Phase::Baseline, Phase::Hostile, Phase::Held] {
            for kind in [CallKind::Query, CallKind::Upload, CallKind::Act] {
                let (calls, [p50, p99]) = stats.quantiles(kind, phase, [0.5, 0.99]);
                if calls > 0 {
                    rows.push(Row { kind: format!("{kind:?}"), phase: format!("{phase:?}"), calls, p50, p99 });
                }
            }
        }
        let p99 = |kind, phase| stats.quantiles(kind, phase, [0.5, 0.99]).1[1];
        let mut targets = Targets::default();
        #[expect(clippy::cast_precision_loss, reason = "far below 2^52 calls")]
        targets.hold(Bound::at_most("calls that failed, limits aside", 0.0), failed as f64);
        targets.hold(Bound::at_most("growth of memory, from a fifth of the time on, %", GROWTH), growth(&memory));
        targets.hold(Bound::at_most("p99 of a query while uploads run, ms", QUERY), p99(CallKind::Query, Phase::Load));
        for (what, kind) in [("queries", CallKind::Query), ("sessions", CallKind::Act)] {
            let ratio = p99(kind, Phase::Hostile) / p99(kind, Phase::Baseline);
            targets.hold(Bound::at_most(&format!("p99 of {what}, beside a hostile client / without"), HOSTILE), ratio);
        }
        let ratio = p99(CallKind::Act, Phase::Held) / p99(CallKind::Act, Phase::Alone);
        targets.hold(Bound::at_most("p99 of a session, beside held connections / alone", HELD_RATIO), ratio);
        for (what, seconds) in [
            ("a silent connection", held.silent),
            ("half a handshake", held.half),
            ("a slow upload", held.slow_uploads),
        ] {
            targets.hold(Bound::at_most(&format!("longest life of {what}, s"), LONGEST_HELD), seconds);
        }
        Self { options: options.clone(), rows, memory, held, flood, limited, failed, reasons, targets }
    }

    /// Calls that failed for another reason than a limit, and their errors.
    pub fn failures(&self) -> (u64, &[String]) {
        (self.failed, &self.reasons)
    }

    /// The longest life of an unused connection or a slow upload, in seconds.
    pub fn held_at_most(&self) -> f64 {
        self.held.silent.max(self.held.half).max(self.held.slow_uploads)
    }

    /// The number of counted calls.
    pub fn calls(&self) -> usize {
        self.rows.iter().map(|row| row.calls).sum()
    }

    /// Prints the tables and writes the file; returns whether every target was met.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn print(&self, out: Option<&Path>) -> Result<bool> {
        let mut table = Table::new();
        table.load_style(ASCII_MARKDOWN).set_header(["calls", "when", "number", "p50 ms", "p99 ms"]);
        for Row { kind, phase, calls, p50, p99 } in &self.rows {
            table.add_row([kind.clone(), phase.clone(), calls.to_string(), time(*p50), time(*p99)]);
        }
        println!("\n{table}\n\n{}\n", self.targets.table());
        println!("rejected by a limit: {}, failed otherwise: {}", self.limited, self.failed);
        println!("the hostile client's calls: {}", self.flood);
        for reason in &self.reasons {
            println!("  {reason}");
        }
        if let Some(out) = out {
            std::fs::write(out, serde_json::to_string_pretty(self)?)?;
        }
        Ok(self.targets.met())
    }
}

/// By how much, in percent, the mean of the last tenth is above that of the tenth after the first fifth.
#[expect(clippy::cast_precision_loss, reason = "far below 2^52 bytes")]
fn growth(memory: &[u64]) -> f64 {
    let tenth = (memory.len() / 10).max(1);
    let mean = |part: &[u64]| part.iter().sum::<u64>() as f64 / part.len() as f64;
    let early = memory.get(2 * tenth..3 * tenth).map(mean);
    let late = memory.len().checked_sub(tenth).and_then(|from| memory.get(from..)).map(mean);
    early.zip(late).map_or(f64::NAN, |(early, late)| (late / early - 1.0) * 100.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_starts_after_a_fifth_of_the_time() {
        let flat: Vec<u64> = (0..100).map(|second| if second < 20 { second } else { 200 }).collect();
        assert!(growth(&flat).abs() < 1e-9);
        let rising: Vec<u64> = (0..100).map(|second| 100 + second).collect();
        assert!((growth(&rising) - 56.225).abs() < 0.01, "{}", growth(&rising));
        assert!(growth(&[]).is_nan());
    }
}
