//! The arguments of an inspection: one definition for the server and for the program.

use std::{ffi::OsString, ops::Range, path::PathBuf};

use clap::Args;

use crate::RecordingsConfig;

/// One inspection.
#[derive(Debug, Clone, PartialEq, Args)]
pub struct Order {
    /// The recording.
    // Like the other paths and names of users, it may begin with a dash.
    #[arg(long, allow_hyphen_values = true)]
    pub recording: PathBuf,
    /// The task's spec, as JSON.
    #[arg(long)]
    pub spec: PathBuf,
    /// Write the verdict to this file, as JSON.
    #[arg(long)]
    pub report: PathBuf,
    /// Write the decoded frames to this file.
    #[arg(long, allow_hyphen_values = true)]
    pub frames: PathBuf,
    /// Copy the intact part of the recording to this file instead of inspecting it; the spec is not read.
    #[arg(long, allow_hyphen_values = true)]
    pub salvage: Option<PathBuf>,
    /// Report what the recording holds instead of inspecting it; the spec is not read and no frames are written.
    #[arg(long, conflicts_with = "salvage")]
    pub survey: bool,
    /// With --survey, write the first picture of each camera into this folder.
    #[arg(long, requires = "survey", allow_hyphen_values = true)]
    pub pictures: Option<PathBuf>,
    /// The recording is a dataset of another program: report what it holds; the spec is not read and no frames are written.
    #[arg(long, conflicts_with_all = ["salvage", "survey"])]
    pub describe: bool,
    /// The recording is a dataset of another program: write episodes of it, by their numbers from 0, into the folder of
    /// frames, as recordings: the first ones of these, at least one; the spec is not read.
    #[arg(long, value_name = "FIRST..END", value_parser = range, conflicts_with_all = ["salvage", "survey", "describe"])]
    pub convert: Option<Range<u64>>,
    /// Cut the recording into episodes at the messages of this topic, into the folder of frames; the spec is not read.
    #[arg(long, value_name = "TOPIC", allow_hyphen_values = true, conflicts_with_all = ["salvage", "survey", "describe", "convert"])]
    pub cut: Option<String>,
    /// Cut the recording into episodes by the ranges of time in this JSON file, into the folder of frames; the spec is not
    /// read.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["salvage", "survey", "describe", "convert", "cut"])]
    pub cut_ranges: Option<PathBuf>,
    /// Write a copy of the recording with the scores in this JSON file beside its messages to the file of frames.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["salvage", "survey", "describe", "convert", "cut", "cut_ranges"])]
    pub extract: Option<PathBuf>,
    /// With --describe or --convert, the column of a dataset that states whether an episode succeeded.
    #[arg(long, value_name = "NAME", allow_hyphen_values = true)]
    pub success_column: Option<String>,
    /// With --describe or --convert, the steps per second of a dataset that does not state them.
    #[arg(long, value_name = "HZ", allow_hyphen_values = true)]
    pub rate_hz: Option<f64>,
    /// Maximum memory in bytes.
    #[arg(long)]
    pub memory_bytes: u64,
    /// Maximum processor time in seconds, to which the pictures that the recording states add their own.
    #[arg(long)]
    pub seconds: u64,
    /// Threads that decode images.
    #[arg(long, default_value_t = 1)]
    pub threads: usize,
    /// Limits on the content of the recording.
    #[command(flatten)]
    pub limits: RecordingsConfig,
}

/// Pixels that add one second of processor time: a quarter of the rate at which H.264 is decoded twice and converted.
const PIXELS_PER_SECOND: u64 = 4_000_000;
/// The most seconds that pictures add: four cameras of 480×640 for an hour at 15 Hz take 4.6 hours of this rate.
const MOST_FOR_PICTURES: u64 = 6 * 3600;

/// The most that the images of a recording may grow by when they are decoded and compressed again without loss: up to 15
/// times for JPEG images at their own size.
const GROWTH: u64 = 16;

/// The most bytes of a file that an inspection with this much memory may write for a recording of this size: decoded images
/// grow with their recording, and a salvaged file is about as large as the original.
pub fn most_written(memory_bytes: u64, recording_bytes: u64) -> u64 {
    memory_bytes.saturating_add(recording_bytes.saturating_mul(GROWTH))
}

impl Order {
    /// The most bytes of a file that the inspection may write.
    pub fn most_written(&self) -> u64 {
        most_written(self.memory_bytes, std::fs::metadata(&self.recording).map_or(0, |file| file.len()))
    }

    /// The processor time in seconds for a recording with this many pixels to decode. The process prints it on a line of its
    /// own before it reads the recording.
    pub fn seconds_for(&self, pixels: u64) -> u64 {
        self.seconds.saturating_add((pixels / PIXELS_PER_SECOND).min(MOST_FOR_PICTURES))
    }

    /// The time in seconds that the process has by the line that it printed, or by the order alone if it printed none.
    pub fn seconds_stated(&self, line: &str) -> u64 {
        line.trim().parse().unwrap_or(self.seconds).min(self.seconds_for(u64::MAX))
    }

    /// The arguments of the program.
    pub fn arguments(&self) -> Vec<OsString> {
        let Self { recording, spec, report, frames, salvage, survey, pictures, limits, .. } = self;
        let Self {
            describe,
            convert,
            cut,
            cut_ranges,
            extract,
            success_column,
            rate_hz,
            memory_bytes,
            seconds,
            threads,
            ..
        } = self;
        let paths = [
            ("--recording", Some(recording)),
            ("--spec", Some(spec)),
            ("--report", Some(report)),
            ("--frames", Some(frames)),
            ("--salvage", salvage.as_ref()),
            ("--pictures", pictures.as_ref()),
            ("--cut-ranges", cut_ranges.as_ref()),
            ("--extract", extract.as_ref()),
        ];
        let paths = paths.into_iter().filter_map(|(flag, path)| Some([flag.into(), path?.into()])).flatten();
        let threads = u64::try_from(*threads).unwrap_or(u64::MAX);
        let numbers = [("--memory-bytes", *memory_bytes), ("--seconds", *seconds), ("--threads", threads)];
        let numbers = numbers.into_iter().flat_map(|(flag, number)| [flag.into(), number.to_string().into()]);
        let modes = [(*survey, "--survey"), (*describe, "--describe")];
        let modes = modes.into_iter().filter(|(set, _)| *set).map(|(_, flag)| flag.into());
        let values = [
            ("--convert", convert.as_ref().map(|episodes| format!("{}..{}", episodes.start, episodes.end))),
            ("--cut", cut.clone()),
            ("--success-column", success_column.clone()),
            ("--rate-hz", rate_hz.map(|rate| rate.to_string())),
        ];
        let values = values.into_iter().filter_map(|(flag, value)| Some([flag.into(), value?.into()])).flatten();
        paths.chain(modes).chain(values).chain(numbers).chain(limits.flags().into_iter().map(Into::into)).collect()
    }
}

/// Reads a range of numbers.
fn range(text: &str) -> Result<Range<u64>, String> {
    let ends = text.split_once("..").and_then(|(first, end)| Some(first.parse().ok()?..end.parse().ok()?));
    ends.ok_or_else(|| "expected two numbers such as 3..7".to_owned())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Flags {
        #[command(flatten)]
        order: Order,
    }

    fn order() -> Order {
        Order {
            recording: "r".into(),
            spec: "s p a c e".into(),
            report: "p".into(),
            frames: "f".into(),
            salvage: None,
            survey: false,
            pictures: None,
            describe: false,
            convert: None,
            cut: None,
            cut_ranges: None,
            extract: None,
            success_column: None,
            rate_hz: None,
            memory_bytes: 7,
            seconds: 1,
            threads: 2,
            limits: RecordingsConfig { max_records: 3, ..gleaner_recording::Limits::ADMITTED.into() },
        }
    }

    #[test]
    fn pictures_add_time_up_to_a_limit() {
        let order = Order { seconds: 120, ..order() };
        let hour = 4 * 15 * 3600 * 480 * 640;
        assert_eq!((order.seconds_for(0), order.seconds_for(hour)), (120, 120 + 16_588));
        assert_eq!(order.seconds_stated("300\n"), 300);
        let most = order.seconds_for(u64::MAX);
        assert_eq!(most, 120 + 6 * 3600);
        for (line, seconds) in [("", 120), ("nonsense\n", 120), ("7\n", 7), ("-1", 120), ("99999999999\n", most)] {
            assert_eq!(order.seconds_stated(line), seconds, "{line:?}");
        }
    }

    #[test]
    fn arguments_parse_to_the_same_order() {
        let order = order();
        let salvage = Order { salvage: Some("repaired".into()), ..order.clone() };
        let survey = Order { survey: true, pictures: Some("p".into()), ..order.clone() };
        let describe = Order { describe: true, rate_hz: Some(12.5), ..order.clone() };
        let convert = Order { convert: Some(3..7), success_column: Some("next success".into()), ..order.clone() };
        let extract = Order { extract: Some("kept.json".into()), ..order.clone() };
        let ranges = Order { cut_ranges: Some("a/ranges.json".into()), ..order.clone() };
        let cut = Order { cut: Some("/episode marker".into()), ..order.clone() };
        let dashes = Order {
            recording: "-odd=name.mcap".into(),
            frames: "-".into(),
            success_column: Some("-ok".into()),
            cut: Some("--cut".into()),
            rate_hz: Some(-1.0),
            ..order.clone()
        };
        let dashed_paths = Order { salvage: Some("--report".into()), ..order.clone() };
        let dashed_pictures = Order { survey: true, pictures: Some("-p".into()), ..order.clone() };
        for order in
            [salvage, survey, describe, convert, cut, ranges, extract, dashes, dashed_paths, dashed_pictures, order]
        {
            let words = [vec!["x".into()], order.arguments()].concat();
            assert_eq!(Flags::try_parse_from(words).unwrap().order, order);
        }
    }
}
