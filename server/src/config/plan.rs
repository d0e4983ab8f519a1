//! Arguments of `plan`: a lab and a machine.

use clap::Args;
use gleaner_capacity::{Camera, Lab, Machine, report};

/// Arguments of `plan`.
#[derive(Debug, Clone, Args)]
pub struct PlanConfig {
    /// Robots that record and are served.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub robots: u32,
    /// Hours that each robot records in a day, up to 24.
    #[arg(long, default_value_t = 2.0, value_name = "HOURS", value_parser = hours)]
    pub hours_a_day: f64,
    /// Length of an episode in seconds.
    #[arg(long, default_value_t = 30.0, value_name = "SECONDS", value_parser = positive)]
    pub episode_seconds: f64,
    /// Steps a second, at which robots record and ask for actions.
    #[arg(long, default_value_t = 20.0, value_name = "HZ", value_parser = positive)]
    pub rate: f64,
    /// Cameras of each robot, such as 2x480x640@jpeg (number, height, width; jpeg, h264, h265 or av1); repeat for cameras
    /// that differ.
    #[arg(long, default_value = "2x480x640@jpeg", value_name = "CAMERAS")]
    pub cameras: Vec<Camera>,
    /// Height and width of pictures at the size of learning.
    #[arg(long, default_value_t = 128, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..))]
    pub learned_pixels: u32,
    /// Expert episodes of a score run. Every segment is compared with all of theirs.
    #[arg(long, default_value_t = 100, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub experts: u32,
    /// Days whose recordings one score run or training reads.
    #[arg(long, default_value_t = 30, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..))]
    pub run_days: u32,
    /// Keep recordings for this many days.
    #[arg(long, default_value_t = 365, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..))]
    pub days: u32,
    /// Processors of the server.
    #[arg(long, default_value_t = 16, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub processors: u32,
    /// Memory of the server in GiB.
    #[arg(long, default_value_t = 128.0, value_name = "GIB", value_parser = positive)]
    pub memory_gib: f64,
    /// Disk of the server in TB.
    #[arg(long, default_value_t = 20.0, value_name = "TB", value_parser = positive)]
    pub disk_tb: f64,
    /// Network towards the robots in Mbit/s.
    #[arg(long, default_value_t = 1000.0, value_name = "MBIT", value_parser = positive)]
    pub network_mbit: f64,
    /// Nodes of a cluster, each with as many processors as the server, among which score runs are divided (`--engine slurm`,
    /// `--score-ranks`), up to 64; 0: they run on the server.
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u32).range(..=64))]
    pub nodes: u32,
    /// Keep recordings in a bucket (`--blob-store`). The disk then holds the cache, the database and copies of the recordings
    /// in use (`--blob-cache-bytes`), which are not counted.
    #[arg(long)]
    pub bucket: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

impl PlanConfig {
    /// The report, as text or JSON.
    pub fn report(&self) -> String {
        let (lab, machine) = self.lab_and_machine();
        let report = report(&lab, &machine);
        if self.json { serde_json::json!(report).to_string() } else { report.to_string() }
    }

    fn lab_and_machine(&self) -> (Lab, Machine) {
        let &Self { robots, hours_a_day, episode_seconds, rate, learned_pixels, experts, run_days, days, .. } = self;
        let cameras = self.cameras.clone();
        let lab = Lab { robots, hours_a_day, episode_seconds, rate, cameras, learned_pixels, experts, run_days, days };
        let &Self { processors, memory_gib, disk_tb, network_mbit, nodes, bucket, .. } = self;
        (lab, Machine { processors, memory_gib, disk_tb, network_mbit, nodes, bucket })
    }
}

fn positive(text: &str) -> Result<f64, String> {
    number(text, |number| number > 0.0 && number <= 1e12, "above 0 and at most 1e12")
}

fn hours(text: &str) -> Result<f64, String> {
    number(text, |number| number > 0.0 && number <= 24.0, "above 0 and at most 24")
}

fn number(text: &str, allowed: impl Fn(f64) -> bool, range: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|&number| allowed(number));
    number.ok_or_else(|| format!("must be a number {range}"))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        plan: PlanConfig,
    }

    fn parse(flags: &[&str]) -> Result<PlanConfig, clap::Error> {
        let words = ["plan", "--robots", "3"].iter().chain(flags);
        Program::try_parse_from(words).map(|program| program.plan)
    }

    #[test]
    fn a_lab_is_read_with_cameras_that_differ() {
        let flags = ["--cameras", "1x720x1280@h264", "--cameras", "2x480x640", "--memory-gib", "64"];
        let (lab, machine) = parse(&flags).unwrap().lab_and_machine();
        assert_eq!((lab.robots, lab.cameras.len(), machine.memory_gib), (3, 2, 64.0));
    }

    #[test]
    fn values_out_of_range_are_rejected_with_the_range() {
        for (flag, value, range) in [
            ("--hours-a-day", "25", "at most 24"),
            ("--rate", "0", "above 0"),
            ("--disk-tb", "nan", "above 0"),
            ("--days", "0", "0 is not in 1.."),
            ("--nodes", "65", "65 is not in 0..=64"),
            ("--cameras", "2x480", "COUNTxHEIGHTxWIDTH"),
        ] {
            let problem = parse(&[flag, value]).unwrap_err().to_string();
            assert!(problem.contains(range) && problem.contains(flag), "{problem}");
        }
    }
}
