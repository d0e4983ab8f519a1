//! What was found: times of every kind of call in every part, targets met or missed, as tables and as JSON.
#![expect(clippy::print_stdout, reason = "a command's output")]

use std::path::Path;

use comfy_table::{Table, presets::ASCII_MARKDOWN};
use gleaner_bench_serving::{
    Result,
    targets::{Asked, Targets, time},
};
use serde::Serialize;

use crate::cli::Options;
use crate::hostile::Held;
use crate::tally::{Doing, Part, Tally};

/// Most that memory may grow from a fifth of the time to its end, in percent.
const GROWTH: f64 = 5.0;
/// 99th percentile of a question while uploads run, in milliseconds.
const QUESTION: f64 = 50.0;
/// What one hostile client may do to the 99th percentile of others.
const HOSTILE: f64 = 1.2;
/// What those who hold connections may do to a robot's.
const BESIEGED: f64 = 2.0;
/// Seconds that anything may be held for nothing.
const HELD: f64 = 10.0;

/// Everything that was found.
#[derive(Serialize)]
pub struct Report {
    options: Options,
    rows: Vec<Row>,
    /// Bytes, one number a second while all clients are at work.
    memory: Vec<u64>,
    held: Held,
    /// Calls of the hostile client's flood that were answered, if only by a refusal.
    flood: u64,
    limited: u64,
    failed: u64,
    reasons: Vec<String>,
    targets: Targets,
}

/// Times in milliseconds.
#[derive(Serialize)]
struct Row {
    doing: String,
    part: String,
    calls: usize,
    p50: f64,
    p99: f64,
}

impl Report {
    pub(crate) fn new(options: &Options, tally: &Tally, memory: Vec<u64>, (held, flood): (Held, u64)) -> Self {
        let (limited, failed, reasons) = tally.refusals();
        let mut rows = Vec::new();
        for part in [Part::Alone, Part::Crowd, Part::Peaceful, Part::Hostile, Part::Besieged] {
            for doing in [Doing::Asking, Doing::Uploading, Doing::Acting] {
                let (calls, [p50, p99]) = tally.quantiles(doing, part, [0.5, 0.99]);
                if calls > 0 {
                    rows.push(Row { doing: format!("{doing:?}"), part: format!("{part:?}"), calls, p50, p99 });
                }
            }
        }
        let p99 = |doing, part| tally.quantiles(doing, part, [0.5, 0.99]).1[1];
        let mut targets = Targets::default();
        #[expect(clippy::cast_precision_loss, reason = "far below 2^52 calls")]
        targets.hold(Asked::most("calls that failed, limits aside", 0.0), failed as f64);
        targets.hold(Asked::most("growth of memory, from a fifth of the time on, %", GROWTH), growth(&memory));
        targets.hold(Asked::most("p99 of a question while uploads run, ms", QUESTION), p99(Doing::Asking, Part::Crowd));
        for (what, doing) in [("questions", Doing::Asking), ("sessions", Doing::Acting)] {
            let ratio = p99(doing, Part::Hostile) / p99(doing, Part::Peaceful);
            targets.hold(Asked::most(&format!("p99 of {what}, beside a hostile client / without"), HOSTILE), ratio);
        }
        let ratio = p99(Doing::Acting, Part::Besieged) / p99(Doing::Acting, Part::Alone);
        targets.hold(Asked::most("p99 of a session, beside held connections / alone", BESIEGED), ratio);
        for (what, seconds) in [
            ("a silent connection", held.silent),
            ("half a handshake", held.half),
            ("a dripping upload", held.dripping),
        ] {
            targets.hold(Asked::most(&format!("longest life of {what}, s"), HELD), seconds);
        }
        Self { options: options.clone(), rows, memory, held, flood, limited, failed, reasons, targets }
    }

    /// Calls that failed though no limit refused them, and why.
    pub fn failures(&self) -> (u64, &[String]) {
        (self.failed, &self.reasons)
    }

    /// The longest, in seconds, that the server held anything for nothing.
    pub fn held_at_most(&self) -> f64 {
        self.held.silent.max(self.held.half).max(self.held.dripping)
    }

    /// Calls that were counted.
    pub fn calls(&self) -> usize {
        self.rows.iter().map(|row| row.calls).sum()
    }

    /// Prints the tables and writes the file; says whether every target was met.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn tell(&self, out: Option<&Path>) -> Result<bool> {
        let mut table = Table::new();
        table.load_style(ASCII_MARKDOWN).set_header(["calls", "when", "number", "p50 ms", "p99 ms"]);
        for Row { doing, part, calls, p50, p99 } in &self.rows {
            table.add_row([doing.clone(), part.clone(), calls.to_string(), time(*p50), time(*p99)]);
        }
        println!("\n{table}\n\n{}\n", self.targets.table());
        println!("refused by a limit: {}, failed otherwise: {}", self.limited, self.failed);
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
    fn growth_is_what_came_after_the_beginning() {
        let flat: Vec<u64> = (0..100).map(|second| if second < 20 { second } else { 200 }).collect();
        assert!(growth(&flat).abs() < 1e-9);
        let rising: Vec<u64> = (0..100).map(|second| 100 + second).collect();
        assert!((growth(&rising) - 56.225).abs() < 0.01, "{}", growth(&rising));
        assert!(growth(&[]).is_nan());
    }
}
