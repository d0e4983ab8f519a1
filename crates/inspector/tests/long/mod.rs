//! A long recording, and its inspection under a limit on memory.

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::process::{Command, ExitStatus};
use std::time::Instant;

use gleaner_inspector::{Order, RecordingsConfig, Verdict};
use gleaner_recording::{
    CameraMessage, CameraRef, CameraSpec, EpisodeWriter, FieldSpec, FrameCache, ImageRef, Limits, ObservationRef,
    PixelFormat, RecordedSize, TaskSpec, encode_jpeg,
};

/// A recording to be made: cameras of one size, all at the rate of the steps.
pub(crate) struct Long {
    pub(crate) cameras: usize,
    pub(crate) height: u32,
    pub(crate) width: u32,
    /// Side of the square pictures that the task learns from; `None`: those of the recording.
    pub(crate) learned: Option<u32>,
    pub(crate) rate_hz: u32,
    pub(crate) steps: u32,
    /// Streams of `gleaner-video`'s fixtures that the cameras show again and again, one each; none: JPEG.
    pub(crate) films: &'static [&'static str],
}

/// A stream: its format, and a packet for each picture.
struct Film {
    format: String,
    packets: Vec<Vec<u8>>,
}

impl Film {
    fn read(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../video/fixtures");
        let described = std::fs::read(folder.join(format!("{name}.json"))).unwrap();
        let described: serde_json::Value = serde_json::from_slice(&described).unwrap();
        let bytes = std::fs::read(folder.join(format!("{name}.packets"))).unwrap();
        let (mut rest, mut packets) = (bytes.as_slice(), Vec::new());
        while let Some((length, after)) = rest.split_first_chunk() {
            let (data, after) = after.split_at(u32::from_le_bytes(*length) as usize);
            packets.push(data.to_vec());
            rest = after;
        }
        Self { format: described["format"].as_str().unwrap().to_owned(), packets }
    }
}

/// Pictures that a camera shows in turn.
const PICTURES: u32 = 48;

impl Long {
    /// The task of the recording, or with `learned` the one that reads it.
    fn spec(&self, learned: Option<u32>) -> TaskSpec {
        let camera = |at| CameraSpec {
            name: format!("camera{at}"),
            height: learned.unwrap_or(self.height),
            width: learned.unwrap_or(self.width),
            depth: false,
            recorded: learned.map(|_| RecordedSize { height: self.height, width: self.width, crop: None }),
        };
        let mut spec: TaskSpec = serde_json::from_value(serde_json::json!({
            "name": "long", "rate_hz": self.rate_hz, "mappings": [], "proprioception": [], "action": [],
        }))
        .unwrap();
        spec.cameras = (0..self.cameras).map(camera).collect();
        (spec.proprioception, spec.action) = (vec![FieldSpec::new("joints", 14)], vec![FieldSpec::new("command", 14)]);
        spec
    }

    /// A scene with slopes, edges and noise that differs from step to step, as JPEG.
    fn picture(&self, at: u32) -> Vec<u8> {
        let mut state = at + 1;
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state >> 28
        };
        let mut rgb = Vec::new();
        for row in 0..self.height {
            for column in 0..self.width {
                let edge = if (column + at * 3) / 24 % 2 == row / 32 % 2 { 70 } else { 0 };
                let base = 40 + edge + row * 60 / self.height + noise();
                rgb.extend([base, base + column * 50 / self.width, 200 - base / 2].map(|v| u8::try_from(v).unwrap()));
            }
        }
        encode_jpeg(&rgb, self.height, self.width, 85).unwrap()
    }

    fn write(&self, path: &Path) {
        let films: Vec<Film> = self.films.iter().map(|name| Film::read(name)).collect();
        let pictures = if films.is_empty() { PICTURES } else { 0 };
        let pictures: Vec<Vec<u8>> = (0..pictures).map(|at| self.picture(at)).collect();
        let mut writer = EpisodeWriter::create(std::fs::File::create(path).unwrap(), &self.spec(None)).unwrap();
        for step in 0..self.steps {
            let values: Vec<f32> =
                (0..14u8).map(|at| f32::from(u16::try_from(step % 1000).unwrap()) + f32::from(at)).collect();
            let camera = |at: u32| {
                let data = &pictures[((step + 7 * at) % PICTURES) as usize];
                CameraRef { color: ImageRef { format: PixelFormat::Jpeg, data }, depth: None }
            };
            let stamp = i64::from(step) * 1_000_000_000 / i64::from(self.rate_hz);
            if films.is_empty() {
                let cameras: Vec<_> = (0..u32::try_from(self.cameras).unwrap()).map(camera).collect();
                writer.observe(stamp, ObservationRef { cameras: &cameras, proprioception: &values }).unwrap();
            } else {
                for (at, Film { format, packets }) in films.iter().enumerate() {
                    let data = &packets[step as usize % packets.len()];
                    writer.camera_message(at, stamp, CameraMessage::Video { format, data }).unwrap();
                }
                writer.sense(stamp, &values).unwrap();
            }
            writer.act(stamp, &values).unwrap();
        }
        writer.finish().unwrap();
    }

    /// Inspects the recording in `folder` with this much memory.
    fn inspect(&self, folder: &Path, memory_bytes: u64, threads: usize) -> (ExitStatus, Option<Verdict>) {
        let order = Order {
            recording: folder.join("recording.mcap"),
            spec: folder.join("spec.json"),
            report: folder.join("report.json"),
            frames: folder.join("frames"),
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
            memory_bytes,
            seconds: 7200,
            threads,
            limits: RecordingsConfig::from(Limits::default()),
        };
        std::fs::write(&order.spec, serde_json::to_vec(&self.spec(self.learned)).unwrap()).unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_gleaner-inspector")).args(order.arguments()).output().unwrap();
        let pixels = self.cameras as u64 * u64::from(self.steps) * u64::from(self.height) * u64::from(self.width);
        let stated = String::from_utf8(output.stdout).unwrap();
        assert_eq!(
            order.seconds_stated(&stated),
            order.seconds_for(pixels),
            "pictures have time of their own: {stated:?}"
        );
        let verdict = std::fs::read(&order.report).ok().and_then(|json| serde_json::from_slice(&json).ok());
        (output.status, verdict)
    }

    /// Checks that the recording is accepted with this much memory, far less than its pictures take, with each of these
    /// numbers of threads, and that all write the same cache. Returns the seconds of each inspection.
    pub(crate) fn passes_within(&self, memory_bytes: u64, threads: &[usize]) -> Vec<f64> {
        let folder = tempfile::tempdir().unwrap();
        self.write(&folder.path().join("recording.mcap"));
        let (mut seconds, mut digests) = (Vec::new(), Vec::new());
        for &threads in threads {
            let begun = Instant::now();
            let (status, verdict) = self.inspect(folder.path(), memory_bytes, threads);
            seconds.push(begun.elapsed().as_secs_f64());
            let Some(Verdict::Usable(report)) = verdict else {
                unreachable!("{threads} threads, {status}: {verdict:?}")
            };
            assert_eq!((report.steps, report.findings.as_slice()), (self.steps.into(), &[][..]));
            let mut digest = crc32fast::Hasher::new();
            std::io::copy(&mut File::open(folder.path().join("frames")).unwrap(), &mut Sink(&mut digest)).unwrap();
            digests.push(digest.finalize());
        }
        assert!(digests.iter().all(|digest| *digest == digests[0]), "{digests:?}");
        let cache = FrameCache::open(&folder.path().join("frames"), &self.spec(self.learned)).unwrap();
        let last = cache.steps() - 1;
        let decoded = cache.frames(last..last + 1).unwrap();
        let pictures = u64::from(self.steps) * self.cameras as u64 * 3 * u64::from(self.height) * u64::from(self.width);
        assert!(pictures > 2 * memory_bytes, "the pictures would fit into memory");
        assert!(decoded.iter().any(|value| *value != decoded[0]));
        seconds
    }
}

/// Writes to a checksum.
struct Sink<'a>(&'a mut crc32fast::Hasher);

impl Write for Sink<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
