//! The pictures of an MP4 file as packets of video: H.264, H.265 and AV1, copied and never coded again.
//!
//! Packets are read one at a time. Must not know datasets or recordings.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::ops::RangeInclusive;
use std::os::unix::fs::FileExt as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use re_mp4::{Avc1Box, HevcBox, Mp4, Sample, StsdBoxContent, TrackKind};

use crate::problem::Problem;

/// Most bytes of a file's tables: those of a day at 30 pictures a second take about a quarter.
const MOST_TABLE_BYTES: u64 = 256 << 20;
/// Most bytes of a packet.
const MOST_BYTES: u64 = 64 << 20;
/// Seconds by which the time of a picture may differ from that of its step.
const TOLERANCE: f64 = 1e-3;

/// An opened file.
pub(super) struct Film {
    pub(super) path: PathBuf,
    file: File,
    samples: Vec<Sample>,
    /// For each picture, in the order in which they are shown, the time in seconds and its packet.
    shown: Vec<(f64, usize)>,
    packaging: Packaging,
    /// (height, width).
    pub(super) size: (u32, u32),
}

/// How packets lie in the file.
enum Packaging {
    /// Units of H.264 or H.265, each after its length, a number of this size.
    Units { format: &'static str, length_bytes: usize, sets: Vec<u8> },
    /// OBUs of AV1.
    Obus { header: Vec<u8> },
}

/// The packets of some steps.
pub(super) struct Part {
    /// Numbers of the packets, in the order of decoding; the first ones may lie before the first step.
    pub(super) packets: RangeInclusive<usize>,
    /// For each step the number of its packet.
    pub(super) of_steps: Vec<usize>,
    /// The step of each packet that has one.
    pub(super) steps: HashMap<usize, usize>,
}

impl Film {
    /// Opens a file and reads its tables.
    ///
    /// # Errors
    /// [`Problem::Unfit`] for damage, and for a codec that is not decoded.
    pub(super) fn open(path: &Path) -> Result<Self, Problem> {
        let file = File::open(path).map_err(Problem::io(path))?;
        let size = file.metadata().map_err(Problem::io(path))?.len();
        // Each byte of a table is read once. The reader never ends where a part of a table states that it has no length.
        let left = (2 * size).min(MOST_TABLE_BYTES);
        let read = || Mp4::read(Bounded { from: BufReader::new(&file), left }, size);
        // The reader panics on tables that contradict each other.
        let damaged = |why: String| unfit(path, &format!("the video is damaged ({why}); copy or download it again"));
        let mp4 =
            catch_unwind(AssertUnwindSafe(read)).map_err(|_| damaged("its tables contradict each other".into()))?;
        let mp4 = mp4.map_err(|error| damaged(error.to_string()))?;
        let track = mp4.tracks().values().find(|track| track.kind == Some(TrackKind::Video));
        let track = track.ok_or_else(|| unfit(path, &undecoded("this codec")))?;
        let described = &track.trak(&mp4).mdia.minf.stbl.stsd.contents;
        let packaging = packaging(described).map_err(|why| unfit(path, &why))?;
        if let Some(outside) = track.samples.iter().find(|sample| sample.offset.saturating_add(sample.size) > size) {
            return Err(damaged(format!("it ends before its picture {}", outside.id)));
        }
        let samples = track.samples.clone();
        let mut shown: Vec<(f64, usize)> = samples.iter().map(time).zip(0..).collect();
        shown.sort_by(|one, other| one.0.total_cmp(&other.0));
        let size = (track.height.into(), track.width.into());
        Ok(Self { path: path.to_owned(), file, samples, shown, packaging, size })
    }

    /// The format of its packets: `h264`, `h265` or `av1`.
    pub(super) fn format(&self) -> &'static str {
        match self.packaging {
            Packaging::Units { format, .. } => format,
            Packaging::Obus { .. } => "av1",
        }
    }

    /// The time in seconds at which a packet's picture is shown.
    pub(super) fn time(&self, packet: usize) -> f64 {
        self.samples.get(packet).map_or(f64::NAN, time)
    }

    /// The packets of evenly spaced steps, the first at `from` seconds.
    ///
    /// # Errors
    /// [`Problem::Unfit`] names the first step without a picture at its time.
    pub(super) fn part(&self, from: f64, steps: usize, rate_hz: f64) -> Result<Part, Problem> {
        // The number of steps is untrusted, so that no memory is reserved for it.
        let mut of_steps = Vec::new();
        for step in 0..steps {
            #[expect(clippy::cast_precision_loss, reason = "an episode has few steps")]
            let time = from + step as f64 / rate_hz;
            let at = self.shown.partition_point(|(shown, _)| *shown < time - TOLERANCE);
            let found = self.shown.get(at).filter(|(shown, _)| (shown - time).abs() <= TOLERANCE);
            of_steps.push(found.ok_or_else(|| self.missing(step, time, rate_hz))?.1);
        }
        let (first, last) = (of_steps.iter().min(), of_steps.iter().max());
        let (Some(&first), Some(&last)) = (first, last) else {
            return Err(unfit(&self.path, "an episode has no steps; remove it from the dataset"));
        };
        let key = (0..=first).rev().find(|&packet| self.samples.get(packet).is_some_and(|sample| sample.is_sync));
        let key = key.ok_or_else(|| unfit(&self.path, "the video begins without a key frame; encode it again"))?;
        let steps = of_steps.iter().enumerate().map(|(step, &packet)| (packet, step)).collect();
        Ok(Part { packets: key..=last, of_steps, steps })
    }

    /// Reads a packet as a decoder takes it.
    ///
    /// # Errors
    /// [`Problem::Unfit`] for damage, [`Problem::Io`].
    pub(super) fn packet(&self, packet: usize) -> Result<Vec<u8>, Problem> {
        let damaged = |why: &str| {
            unfit(&self.path, &format!("picture {packet} of the video is damaged ({why}); copy or download it again"))
        };
        let sample = self.samples.get(packet).ok_or_else(|| damaged("it is not in the file"))?;
        let size = usize::try_from(sample.size).ok().filter(|_| sample.size <= MOST_BYTES);
        let mut data = vec![0; size.ok_or_else(|| damaged("it is too large"))?];
        self.file.read_exact_at(&mut data, sample.offset).map_err(Problem::io(&self.path))?;
        let mut out = Vec::with_capacity(data.len() + 64);
        match &self.packaging {
            Packaging::Obus { header } => {
                if sample.is_sync {
                    out.extend_from_slice(header);
                }
                out.extend_from_slice(&data);
            }
            Packaging::Units { length_bytes, sets, .. } => {
                if sample.is_sync {
                    out.extend_from_slice(sets);
                }
                let mut rest = data.as_slice();
                while !rest.is_empty() {
                    let (length, after) =
                        rest.split_at_checked(*length_bytes).ok_or_else(|| damaged("a unit is cut"))?;
                    let length = length.iter().fold(0, |length, byte| length << 8 | usize::from(*byte));
                    let (unit, after) = after.split_at_checked(length).ok_or_else(|| damaged("a unit is cut"))?;
                    add_unit(&mut out, unit);
                    rest = after;
                }
            }
        }
        Ok(out)
    }

    fn missing(&self, step: usize, time: f64, rate_hz: f64) -> Problem {
        let shown = &self.shown;
        let (first, last) = (shown.first(), shown.last());
        let rate = match first.zip(last).map(|(first, last)| last.0 - first.0) {
            #[expect(clippy::cast_precision_loss, reason = "a video is short enough")]
            Some(span) if span > 0.0 => format!("{:.2}", (shown.len() - 1) as f64 / span),
            Some(_) | None => "0".to_owned(),
        };
        let end = last.map_or(0.0, |last| last.0);
        unfit(
            &self.path,
            &format!(
                "the video has no picture at {time:.4} s, the time of step {step} at {rate_hz} fps: its {} pictures end at \
                 {end:.4} s and come at {rate} fps; correct `fps` in meta/info.json, or encode the video again",
                shown.len()
            ),
        )
    }
}

/// The time in seconds at which a picture is shown.
#[expect(clippy::cast_precision_loss, reason = "a video is short enough")]
fn time(sample: &Sample) -> f64 {
    sample.composition_timestamp as f64 / sample.timescale.max(1) as f64
}

/// A reader of at most `left` bytes, wherever they lie.
struct Bounded<R> {
    from: R,
    left: u64,
}

impl<R: Read> Read for Bounded<R> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let count = self.from.read(out)?;
        let left = self.left.checked_sub(count as u64);
        self.left = left.ok_or_else(|| std::io::Error::other("its tables are read again and again"))?;
        Ok(count)
    }
}

impl<R: Seek> Seek for Bounded<R> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.from.seek(to)
    }
}

fn packaging(described: &StsdBoxContent) -> Result<Packaging, String> {
    match described {
        StsdBoxContent::Av01(av1) => Ok(Packaging::Obus { header: av1.av1c.contents.config_obus.clone() }),
        StsdBoxContent::Avc1(avc) => Ok(h264(avc)),
        StsdBoxContent::Hvc1(hevc) | StsdBoxContent::Hev1(hevc) => Ok(h265(hevc)),
        StsdBoxContent::Vp08(_) => Err(undecoded("VP8")),
        StsdBoxContent::Vp09(_) => Err(undecoded("VP9")),
        StsdBoxContent::Mp4a(_) | StsdBoxContent::Tx3g(_) | StsdBoxContent::Unknown(_) => Err(undecoded("this codec")),
    }
}

fn undecoded(codec: &str) -> String {
    format!(
        "video of {codec} is not decoded; encode it as AV1, H.264 or H.265, as with `ffmpeg -i IN -c:v libsvtav1 OUT`"
    )
}

fn h264(avc: &Avc1Box) -> Packaging {
    let avc = &avc.avcc.contents;
    let mut sets = Vec::new();
    for set in avc.sequence_parameter_sets.iter().chain(&avc.picture_parameter_sets) {
        add_unit(&mut sets, &set.bytes);
    }
    Packaging::Units { format: "h264", length_bytes: usize::from(avc.length_size_minus_one & 3) + 1, sets }
}

fn h265(hevc: &HevcBox) -> Packaging {
    let config = &hevc.hvcc.contents;
    let mut sets = Vec::new();
    for set in config.arrays.iter().flat_map(|array| &array.nalus) {
        add_unit(&mut sets, &set.data);
    }
    Packaging::Units { format: "h265", length_bytes: usize::from(config.length_size_minus_one & 3) + 1, sets }
}

/// A unit as Annex B has it.
fn add_unit(out: &mut Vec<u8>, unit: &[u8]) {
    out.extend_from_slice(&[0, 0, 0, 1]);
    out.extend_from_slice(unit);
}

fn unfit(path: &Path, problem: &str) -> Problem {
    Problem::Unfit(format!("{}: {problem}", path.display()))
}
