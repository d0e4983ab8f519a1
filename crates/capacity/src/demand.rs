//! The parts of a server that a lab needs, and how much of each.

use serde::Serialize;

use crate::{camera::Camera, lab::Lab, machine::Machine, rate};

const DAY: f64 = 86_400.0;
/// Seconds in which a training should begin.
const START: f64 = 60.0;
/// Share of the memory that the newest run may fill.
const MEMORY_SHARE: f64 = 0.5;

/// A part that can give out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// Uploads while the robots record.
    Network,
    /// Recordings, cache and database.
    Disk,
    /// Decoding of recordings.
    Inspection,
    /// Writes of the database.
    Writes,
    /// Scores of the newest run, in half of the memory.
    Memory,
    /// One score run, finished within a day.
    Scoring,
    /// The first step of a training, within a minute.
    TrainingStart,
    /// Actions for all robots at once.
    Sessions,
}

/// What a lab needs of one part, and what the server has of it, in the same unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Demand {
    /// The part.
    pub part: Part,
    /// Needed.
    pub needed: f64,
    /// What there is of it.
    pub available: f64,
    /// The unit of both.
    pub unit: &'static str,
}

impl Demand {
    /// The share of the part that is used; above 1 the part does not suffice.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.needed / self.available
    }

    /// What a lab needs of each part of this machine.
    #[must_use]
    pub fn of(lab: &Lab, machine: &Machine) -> Vec<Self> {
        let processors = f64::from(machine.processors);
        let robots = f64::from(lab.robots);
        let demand = |part, needed, available, unit| Self { part, needed, available, unit };
        vec![
            demand(Part::Network, robots * lab.bytes_a_second() * 8.0 / 1e6, machine.network_mbit, "Mbit/s"),
            demand(Part::Disk, disk_bytes(lab, machine) / 1e12, machine.disk_tb, "TB"),
            demand(Part::Inspection, inspection_seconds(lab) / 3600.0, processors * 24.0, "processor hours a day"),
            demand(
                Part::Writes,
                lab.episodes_a_day() * rate::WRITES_AN_EPISODE / DAY,
                rate::WRITES_A_SECOND,
                "writes a second",
            ),
            demand(
                Part::Memory,
                lab.run_segments() * rate::MEMORY_BYTES_A_SEGMENT / f64::from(1 << 30),
                machine.memory_gib * MEMORY_SHARE,
                "GiB",
            ),
            demand(
                Part::Scoring,
                scoring_seconds(lab) / 3600.0,
                machine.scoring_processors() * 24.0,
                "processor hours a run",
            ),
            demand(Part::TrainingStart, lab.run_episodes() * rate::START_SECONDS_AN_EPISODE, START, "s"),
            demand(Part::Sessions, robots * lab.rate, rate::ACTIONS_A_SECOND * processors, "actions a second"),
        ]
    }
}

fn disk_bytes(lab: &Lab, machine: &Machine) -> f64 {
    let learned = f64::from(lab.learned_pixels) * f64::from(lab.learned_pixels);
    let cached = lab.camera_count() * learned * rate::CACHE_BYTES_A_PIXEL;
    let recorded = if machine.bucket { 0.0 } else { lab.recorded_bytes_a_step() };
    let step = recorded + cached + rate::ROW_BYTES_A_SEGMENT;
    lab.steps() * step + lab.episodes() * rate::ROW_BYTES_AN_EPISODE
}

/// Seconds of one processor for the recordings of a day.
fn inspection_seconds(lab: &Lab) -> f64 {
    lab.steps_a_day() * lab.cameras.iter().map(Camera::inspection_seconds).sum::<f64>()
}

/// Seconds of one processor for every segment against every expert segment.
fn scoring_seconds(lab: &Lab) -> f64 {
    let experts = f64::from(lab.experts) * lab.episode_seconds * lab.rate;
    experts * lab.run_segments() * lab.camera_count() * rate::VALUES_A_CAMERA / rate::COMPARED_VALUES_A_SECOND
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lab(robots: u32) -> Lab {
        Lab {
            robots,
            hours_a_day: 1.0,
            episode_seconds: 10.0,
            rate: 10.0,
            cameras: vec!["2x480x640@jpeg".parse().unwrap()],
            learned_pixels: 128,
            experts: 100,
            run_days: 10,
            days: 10,
        }
    }

    const MACHINE: Machine =
        Machine { processors: 2, memory_gib: 24.0, disk_tb: 1.0, network_mbit: 1000.0, nodes: 0, bucket: false };

    fn part(demands: &[Demand], part: Part) -> Demand {
        *demands.iter().find(|demand| demand.part == part).unwrap()
    }

    #[test]
    #[expect(clippy::float_cmp, reason = "the same numbers, computed by hand")]
    fn needs_follow_the_rates() {
        let demands = Demand::of(&lab(1), &MACHINE);
        let network = part(&demands, Part::Network);
        assert!((network.needed - 2.0 * 68_000.0 * 10.0 * 8.0 / 1e6).abs() < 1e-9, "{network:?}");
        let inspection = part(&demands, Part::Inspection);
        assert!((inspection.needed - 36_000.0 * 2.0 / 291.0 / 3600.0).abs() < 1e-9, "{inspection:?}");
        assert_eq!(inspection.available, 48.0);
        assert_eq!(part(&demands, Part::Sessions).needed, 10.0);
        // 360,000 steps: recordings of 136 kB, caches of 52 kB.
        let disk = part(&demands, Part::Disk);
        assert!((0.067..0.069).contains(&disk.needed), "{disk:?}");
    }

    /// Caches of 52 kB for each of 360,000 steps stay on the disk; 4 nodes have 4 times the processors of the server.
    #[test]
    fn a_bucket_takes_the_recordings_and_nodes_the_score_runs() {
        let larger = Machine { bucket: true, nodes: 4, ..MACHINE };
        let (alone, helped) = (Demand::of(&lab(1), &MACHINE), Demand::of(&lab(1), &larger));
        let disk = part(&helped, Part::Disk).needed;
        assert!((0.018..0.020).contains(&disk), "{disk}");
        let (alone, helped) = (part(&alone, Part::Scoring), part(&helped, Part::Scoring));
        assert_eq!((helped.needed, helped.available), (alone.needed, 4.0 * alone.available));
    }

    #[test]
    fn every_need_grows_with_the_lab() {
        let (one, ten) = (Demand::of(&lab(1), &MACHINE), Demand::of(&lab(10), &MACHINE));
        for (one, ten) in one.iter().zip(&ten) {
            assert!((ten.share() / one.share() / 10.0 - 1.0).abs() < 1e-9, "{one:?} {ten:?}");
        }
    }

    /// The scores of the lab of `make bench-lab` took 497 MiB (docs/scale.md).
    #[test]
    fn memory_of_ten_million_segments_is_the_measured_one() {
        let lab = Lab { run_days: 1, hours_a_day: 1e7 / 36_000.0, ..lab(1) };
        let memory = part(&Demand::of(&lab, &MACHINE), Part::Memory);
        assert!((0.47..0.50).contains(&memory.needed), "{memory:?}");
    }
}
