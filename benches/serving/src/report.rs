//! Results of the serving benchmark: loads and targets as tables and as JSON.
#![expect(clippy::print_stdout, reason = "a command's output")]

use std::path::Path;

use comfy_table::{CellAlignment, Table, presets::ASCII_MARKDOWN};
use serde::Serialize;

use crate::Result;
use crate::cli::{Kind, Options, Part, Size};
use crate::load::Summary;
use crate::scene::Images;
pub use crate::targets::Bound;
use crate::targets::{Targets, time};

/// The results.
#[derive(Debug, Serialize)]
pub struct Report {
    conditions: Conditions,
    pub rows: Vec<Row>,
    pub peers: Vec<PeerRow>,
    targets: Targets,
}

/// The conditions of the measurements.
#[derive(Debug, Serialize)]
struct Conditions {
    preset: Size,
    policy: Kind,
    parts: Vec<Part>,
    processors: usize,
    /// Threads of each model.
    model_threads: u32,
    load_threads: u32,
    /// Threads of the concurrent training job.
    worker_threads: u32,
    load_average: String,
}

/// A load on gleaner; times in milliseconds.
#[derive(Debug, Serialize)]
pub struct Row {
    pub images: Images,
    pub sessions: usize,
    pub beside_training: bool,
    /// Median of the same request with the same weights in this process: the model, and the decoding of JPEG.
    pub alone: f64,
    pub load: Summary,
}

/// The same load on one of several servers.
#[derive(Debug, Serialize)]
pub struct PeerRow {
    pub server: &'static str,
    pub sessions: usize,
    pub load: Summary,
}

impl Report {
    pub fn begin(options: &Options) -> Self {
        let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
        let conditions = Conditions {
            preset: options.preset,
            policy: options.policy,
            parts: options.parts.clone(),
            processors: std::thread::available_parallelism().map_or(0, usize::from),
            model_threads: 1,
            load_threads: 1,
            worker_threads: options.worker_threads,
            load_average: load.split_whitespace().take(3).collect::<Vec<_>>().join(" "),
        };
        Self { conditions, rows: Vec::new(), peers: Vec::new(), targets: Targets::default() }
    }

    /// Compares a figure with its target.
    pub fn target(&mut self, bound: Bound, found: f64) {
        self.targets.hold(bound, found);
    }

    /// Prints the tables and writes the file; returns whether every target was met.
    pub fn finish(&self, out: Option<&Path>) -> Result<bool> {
        let Conditions { preset, policy, processors, worker_threads, load_average, .. } = &self.conditions;
        println!(
            "\npolicy {}, preset {}, 2 x 128 x 128 RGB, {processors} processors, load average {load_average} at the beginning",
            policy.name(),
            format!("{preset:?}").to_lowercase()
        );
        println!("threads: 1 for each model, 1 for the load, {worker_threads} for the training job; times in ms\n");
        if !self.rows.is_empty() {
            println!("{}\n", self.loads());
        }
        if !self.peers.is_empty() {
            println!("{}\n", self.beside_peers());
        }
        println!("{}", self.targets.table());
        if let Some(out) = out {
            std::fs::write(out, serde_json::to_string_pretty(self)?)?;
        }
        Ok(self.targets.met())
    }

    fn loads(&self) -> Table {
        let mut table = numbers(&[
            "images",
            "sessions",
            "p50",
            "p99",
            "p99.9",
            "actions/s",
            "in model",
            "batch",
            "model",
            "decode",
            "queue",
            "gather",
            "extra p50",
            "extra p99",
            "alone",
        ]);
        for Row { images, sessions, beside_training, alone, load } in &self.rows {
            let images = format!("{images:?}{}", if *beside_training { ", training beside" } else { "" });
            let mut cells = vec![images, sessions.to_string()];
            cells.extend(first_cells(load));
            if let Some(served) = &load.served {
                cells.push(format!("{:.0} %", served.model_share * 100.0));
                cells.push(format!("{:.1}", served.mean_batch));
                let times = [served.model_p50, served.decode_p50, served.queue_p50, served.gather_p50];
                cells.extend(times.map(time));
                cells.extend([served.extra_p50, served.extra_p99].map(time));
            }
            cells.push(time(*alone));
            table.add_row(cells);
        }
        table
    }

    fn beside_peers(&self) -> Table {
        let mut table = numbers(&["server", "sessions", "p50", "p99", "p99.9", "actions/s"]);
        for PeerRow { server, sessions, load } in &self.peers {
            let mut cells = vec![(*server).to_owned(), sessions.to_string()];
            cells.extend(first_cells(load));
            table.add_row(cells);
        }
        table
    }
}

/// Prints a line of progress.
pub fn progress(line: &str) {
    println!("{line}");
}

fn numbers(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(ASCII_MARKDOWN).set_header(header);
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

fn first_cells(load: &Summary) -> [String; 4] {
    [time(load.p50), time(load.p99), time(load.p999), format!("{:.0}", load.actions_per_second)]
}
