//! Limits on the content of a recording, and on the work of its reader.

use clap::Args;
use gleaner_recording::{Limits, MOST_JSON_DEPTH};

/// Limits on the content of a recording.
#[derive(Debug, Clone, PartialEq, Eq, Args)]
#[command(next_help_heading = "Limits on recordings")]
pub struct RecordingsConfig {
    /// Maximum size of a chunk in bytes, both compressed and decompressed, at least 1. Larger chunks take more memory
    /// in an inspection.
    #[arg(long, env = "GLEANER_MAX_CHUNK_BYTES", value_name = "BYTES", default_value_t = Limits::default().chunk_bytes)]
    pub max_chunk_bytes: usize,
    /// Maximum size of a record in bytes, at least 1. Larger records take more memory in an inspection.
    #[arg(long, env = "GLEANER_MAX_RECORD_BYTES", value_name = "BYTES", default_value_t = Limits::default().record_bytes)]
    pub max_record_bytes: usize,
    /// Maximum number of records, at least 1. More records take more time in an inspection.
    #[arg(long, env = "GLEANER_MAX_RECORDS", value_name = "N", default_value_t = Limits::default().records)]
    pub max_records: u64,
    /// Maximum number of channels, and of schemas, at least 1.
    #[arg(long, env = "GLEANER_MAX_CHANNELS", value_name = "N", default_value_t = Limits::default().channels)]
    pub max_channels: usize,
    /// Maximum length in bytes of the name of a topic, a schema or an encoding, at least 1.
    #[arg(long, env = "GLEANER_MAX_NAME_BYTES", value_name = "BYTES", default_value_t = Limits::default().name_bytes)]
    pub max_name_bytes: usize,
    /// Maximum nesting depth of a JSON message, at least 1. Deeper messages take more stack in an inspection.
    #[arg(long, env = "GLEANER_MAX_JSON_DEPTH", value_name = "N", default_value_t = Limits::default().json_depth)]
    pub max_json_depth: usize,
    /// Maximum number of pixels of an image, at least 1. Larger images take more memory in an inspection.
    #[arg(long, env = "GLEANER_MAX_IMAGE_PIXELS", value_name = "PIXELS", default_value_t = Limits::default().image_pixels)]
    pub max_image_pixels: u64,
}

impl From<Limits> for RecordingsConfig {
    fn from(limits: Limits) -> Self {
        let Limits { chunk_bytes, record_bytes, records, channels, name_bytes, json_depth, image_pixels } = limits;
        Self {
            max_chunk_bytes: chunk_bytes,
            max_record_bytes: record_bytes,
            max_records: records,
            max_channels: channels,
            max_name_bytes: name_bytes,
            max_json_depth: json_depth,
            max_image_pixels: image_pixels,
        }
    }
}

impl RecordingsConfig {
    /// The limits for the reader of recordings.
    pub fn limits(&self) -> Limits {
        Limits {
            chunk_bytes: self.max_chunk_bytes,
            record_bytes: self.max_record_bytes,
            records: self.max_records,
            channels: self.max_channels,
            name_bytes: self.max_name_bytes,
            json_depth: self.max_json_depth,
            image_pixels: self.max_image_pixels,
        }
    }

    /// The same limits as flags, for the inspecting process.
    pub fn flags(&self) -> Vec<String> {
        let Self {
            max_chunk_bytes,
            max_record_bytes,
            max_records,
            max_channels,
            max_name_bytes,
            max_json_depth,
            max_image_pixels,
        } = self;
        vec![
            format!("--max-chunk-bytes={max_chunk_bytes}"),
            format!("--max-record-bytes={max_record_bytes}"),
            format!("--max-records={max_records}"),
            format!("--max-channels={max_channels}"),
            format!("--max-name-bytes={max_name_bytes}"),
            format!("--max-json-depth={max_json_depth}"),
            format!("--max-image-pixels={max_image_pixels}"),
        ]
    }

    /// Checks each value.
    ///
    /// # Errors
    /// A sentence that names the flag and the fix.
    pub fn validate(&self) -> Result<(), String> {
        let sizes = [
            ("--max-chunk-bytes", self.max_chunk_bytes),
            ("--max-record-bytes", self.max_record_bytes),
            ("--max-channels", self.max_channels),
            ("--max-name-bytes", self.max_name_bytes),
            ("--max-json-depth", self.max_json_depth),
        ];
        let counts = [("--max-records", self.max_records), ("--max-image-pixels", self.max_image_pixels)];
        let nothing = sizes.iter().filter(|(_, value)| *value == 0).map(|(flag, _)| flag);
        let mut nothing = nothing.chain(counts.iter().filter(|(_, value)| *value == 0).map(|(flag, _)| flag));
        if let Some(flag) = nothing.next() {
            return Err(format!("{flag}: must be at least 1"));
        }
        if self.max_json_depth > MOST_JSON_DEPTH {
            return Err(format!("--max-json-depth: must be at most {MOST_JSON_DEPTH}"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Flags {
        #[command(flatten)]
        recordings: RecordingsConfig,
    }

    fn read(flags: &[String]) -> RecordingsConfig {
        Flags::try_parse_from([vec!["x".to_owned()], flags.to_vec()].concat()).unwrap().recordings
    }

    #[test]
    fn default_limits_are_those_of_the_reader() {
        assert_eq!(read(&[]).limits(), Limits::default());
        assert!(read(&[]).validate().is_ok());
    }

    #[test]
    fn flags_have_every_limit() {
        let all = RecordingsConfig {
            max_chunk_bytes: 1,
            max_record_bytes: 2,
            max_records: 3,
            max_channels: 4,
            max_name_bytes: 5,
            max_json_depth: 6,
            max_image_pixels: 7,
        };
        assert_eq!(read(&all.flags()), all);
        assert_eq!(RecordingsConfig::from(all.limits()), all);
    }

    #[test]
    fn invalid_limit_is_named_by_its_flag() {
        for flag in ["--max-records=0", "--max-name-bytes=0", "--max-json-depth=0", "--max-json-depth=128"] {
            let problem = read(&[flag.to_owned()]).validate().unwrap_err();
            assert!(flag.starts_with(problem.split(':').next().unwrap()), "{problem}");
        }
    }
}
