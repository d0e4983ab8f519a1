//! The report for people and programs.

use std::fmt;

use comfy_table::{CellAlignment, ContentArrangement, Table, presets::NOTHING};
use serde::Serialize;

use crate::{
    demand::{Demand, Part},
    lab::Lab,
    limit::largest_lab,
    machine::Machine,
};

/// A lab, its server and its needs; the part that is used most comes first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    lab: Lab,
    machine: Machine,
    episodes_a_day: f64,
    gigabytes_a_day: f64,
    episodes: f64,
    recorded_terabytes: f64,
    run_segments: f64,
    parts: Vec<Row>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct Row {
    #[serde(flatten)]
    demand: Demand,
    share: f64,
    largest_lab: u32,
}

/// The report of a lab on a machine.
#[must_use]
pub fn report(lab: &Lab, machine: &Machine) -> Report {
    let row =
        |demand: Demand| Row { demand, share: demand.share(), largest_lab: largest_lab(lab, machine, demand.part) };
    let mut parts: Vec<Row> = Demand::of(lab, machine).into_iter().map(row).collect();
    parts.sort_by(|a, b| b.share.total_cmp(&a.share));
    Report {
        lab: lab.clone(),
        machine: *machine,
        episodes_a_day: lab.episodes_a_day(),
        gigabytes_a_day: lab.bytes_a_day() / 1e9,
        episodes: lab.episodes(),
        recorded_terabytes: lab.recorded_bytes() / 1e12,
        run_segments: lab.run_segments(),
        parts,
    }
}

impl Part {
    fn words(self, machine: &Machine) -> &'static str {
        match self {
            Self::Network => "network while robots record",
            Self::Disk if machine.bucket => "disk for cache and database",
            Self::Disk => "disk for recordings, cache and database",
            Self::Inspection => "inspection of recordings",
            Self::Writes => "durable writes of the database",
            Self::Memory => "newest score run, in half of the memory",
            Self::Scoring if machine.nodes > 0 => "score run on the nodes, within a day",
            Self::Scoring => "score run, within a day",
            Self::TrainingStart => "first step of a training, within a minute",
            Self::Sessions => "actions for all robots at once",
        }
    }

    /// What helps when one machine does not suffice.
    fn remedy(self, machine: &Machine) -> &'static str {
        match self {
            Self::Network => "record video in place of JPEG, or push at night (`gleaner push` resumes)",
            Self::Disk if machine.bucket => {
                "limit the cache (`--max-cache-bytes`), keep recordings for fewer days, or learn from smaller pictures"
            }
            Self::Disk => {
                "keep recordings for fewer days, record video, keep recordings in a bucket (`--blob-store`), or limit the cache \
                 (`--max-cache-bytes`)"
            }
            Self::Inspection => "more processors, or JPEG, which decodes faster than video",
            Self::Writes => "longer episodes",
            Self::Memory => "score fewer days in one run (a snapshot of some cohorts), or more memory",
            Self::Scoring if machine.nodes > 0 => {
                "more nodes, compare with fewer experts, or extend an earlier run, which compares new episodes alone"
            }
            Self::Scoring => {
                "compare with fewer experts, extend an earlier run, which compares new episodes alone, or divide the run \
                 among nodes (`--score-ranks`)"
            }
            Self::TrainingStart => "train on the best part of a dataset, or on a snapshot of fewer days",
            Self::Sessions => "more processors, or a second server for some of the robots",
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { lab, machine, .. } = self;
        writeln!(
            f,
            "{} robots record {} episodes and {} GB a day, and {} episodes are kept. A score run has {} segments.",
            lab.robots,
            rounded(self.episodes_a_day),
            rounded(self.gigabytes_a_day),
            rounded(self.episodes),
            rounded(self.run_segments),
        )?;
        let Machine { processors, memory_gib, disk_tb, network_mbit, nodes, bucket } = machine;
        if *bucket {
            writeln!(f, "The bucket holds {} TB of recordings.", rounded(self.recorded_terabytes))?;
        }
        let beside = match nodes {
            0 => String::new(),
            1 => format!(", and a node of {processors} processors"),
            _ => format!(", and {nodes} nodes of {processors} processors"),
        };
        writeln!(
            f,
            "One server with {processors} processors, {memory_gib} GiB of memory, {disk_tb} TB of disk and \
             {network_mbit} Mbit/s{beside}:\n",
        )?;
        let mut table = Table::new();
        table.load_style(NOTHING).set_content_arrangement(ContentArrangement::Disabled);
        table.set_header(["part", "needed", "available", "unit", "used", "enough for"]);
        table.add_rows(self.parts.iter().map(|Row { demand, share, largest_lab }| {
            [
                demand.part.words(machine).to_owned(),
                rounded(demand.needed),
                rounded(demand.available),
                demand.unit.to_owned(),
                if *share > 10.0 {
                    format!("{} times", rounded(*share))
                } else {
                    format!("{} %", rounded(share * 100.0))
                },
                format!("{} robots", rounded(f64::from(*largest_lab))),
            ]
        }));
        for (index, column) in table.column_iter_mut().enumerate() {
            column.set_padding((0, 2));
            if [1, 2, 4, 5].contains(&index) {
                column.set_cell_alignment(CellAlignment::Right);
            }
        }
        writeln!(f, "{}\n", table.trim_fmt())?;
        let beyond: Vec<&Row> = self.parts.iter().filter(|row| row.share > 1.0).collect();
        let Some(first) = self.parts.first() else { return Ok(()) };
        if beyond.is_empty() {
            writeln!(
                f,
                "This suffices. The first part to give out is {}, above {} robots.",
                first.demand.part.words(machine),
                first.largest_lab
            )?;
        }
        for row in beyond {
            writeln!(
                f,
                "Not enough: {}. Remedy: {}.",
                row.demand.part.words(machine),
                row.demand.part.remedy(machine)
            )?;
        }
        if *nodes > 0 {
            writeln!(f, "Nodes are taken to share a score run without loss; two processes gained 1.73 to 1.85 times.")?;
        }
        write!(f, "The rates were measured on two processors and scaled; docs/scale.md names their sources.")
    }
}

/// A number with at most three digits that matter, and a word for its thousands.
fn rounded(number: f64) -> String {
    let (number, word) = match number.abs() {
        0.0 => return "0".to_owned(),
        large if large >= 1e12 => (number / 1e12, " trillion"),
        large if large >= 1e9 => (number / 1e9, " billion"),
        large if large >= 1e6 => (number / 1e6, " million"),
        _ => (number, ""),
    };
    let digits = match number.abs() {
        large if large >= 100.0 => 0,
        large if large >= 10.0 => 1,
        large if large >= 1.0 => 2,
        _ => 3,
    };
    let text = format!("{number:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    let text = if text == "0" { "under 0.001" } else { text };
    format!("{text}{word}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lab(robots: u32) -> Lab {
        Lab {
            robots,
            hours_a_day: 6.0,
            episode_seconds: 30.0,
            rate: 20.0,
            cameras: vec!["2x480x640@jpeg".parse().unwrap()],
            learned_pixels: 128,
            experts: 100,
            run_days: 30,
            days: 365,
        }
    }

    const MACHINE: Machine =
        Machine { processors: 16, memory_gib: 128.0, disk_tb: 20.0, network_mbit: 1000.0, nodes: 0, bucket: false };

    #[test]
    fn numbers_have_three_digits_that_matter() {
        for (number, text) in [
            (0.0, "0"),
            (0.00001, "under 0.001"),
            (0.25, "0.25"),
            (1.0, "1"),
            (12.34, "12.3"),
            (100.0, "100"),
            (1234.0, "1234"),
            (2.5e6, "2.5 million"),
            (3e10, "30 billion"),
        ] {
            assert_eq!(rounded(number), text);
        }
    }

    #[test]
    fn parts_that_do_not_suffice_come_first_with_a_remedy() {
        let report = report(&lab(100), &MACHINE);
        let shares: Vec<f64> = report.parts.iter().map(|row| row.share).collect();
        assert!(shares.is_sorted_by(|a, b| a >= b), "{shares:?}");
        for row in &report.parts {
            assert_eq!(row.share > 1.0, row.largest_lab < 100, "{row:?}");
        }
        let text = report.to_string();
        assert_eq!(text.matches("Not enough: ").count(), shares.iter().filter(|share| **share > 1.0).count());
    }

    #[test]
    fn a_bucket_and_nodes_are_named() {
        let text = report(&lab(100), &Machine { nodes: 8, bucket: true, ..MACHINE }).to_string();
        for part in [
            "The bucket holds 2144 TB of recordings.",
            "1000 Mbit/s, and 8 nodes of 16 processors:",
            "disk for cache and database",
            "score run on the nodes, within a day",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(!text.contains("--blob-store"), "{text}");
    }

    #[test]
    fn the_first_part_to_give_out_is_named() {
        let small = Lab { days: 1, ..lab(1) };
        let text = report(&small, &MACHINE).to_string();
        assert!(text.contains("This suffices. The first part to give out is"), "{text}");
    }
}
