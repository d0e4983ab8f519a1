//! The first inputs of each target: output of the project's writers, and small real recordings. They are written into
//! `growth/`; the permanent corpus (`corpus/`) is in the repository.

use std::fs;
use std::path::Path;

use image::{ExtendedColorType, ImageEncoder};

use crate::recording::{Channel, Dialect, dialects, input};
use crate::task::{SIDE, written};
use crate::{append, stretch, take};

/// Larger files make slow inputs.
const MOST_BYTES: u64 = 64 << 10;

type Failure = Box<dyn std::error::Error>;

/// Writes the first inputs of a target into its folder in `growth/`.
///
/// # Panics
/// If the folder is not writable.
pub fn write(target: &str) {
    let written = match target {
        "container" => containers(),
        "foxglove" => foxglove().and_then(|steps| seed(target, "steps", &steps)),
        "ros2" => seed(target, "steps", &ros2()),
        "json" => seed(target, "steps", &json()),
        "path" => paths(),
        "cdr" => schemas(target, dialects::ros2(), ros2()),
        "protobuf" => foxglove().and_then(|steps| schemas(target, dialects::foxglove(), steps)),
        "image" => images(),
        "checkpoint" => checkpoints(),
        #[cfg(feature = "datasets")]
        "dataset" => datasets(),
        "observation" => seed(target, "raw", &observation()),
        #[cfg(feature = "server")]
        "wire" => messages(),
        _ => Ok(()),
    };
    written.unwrap_or_else(|error| panic!("writing the first inputs of {target}: {error}"));
}

fn seed(target: &str, name: &str, bytes: &[u8]) -> Result<(), Failure> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("growth").join(target);
    fs::create_dir_all(&folder)?;
    Ok(fs::write(folder.join(name), bytes)?)
}

/// Whole files: as written, without compression and checksums, truncated, and the real recordings.
fn containers() -> Result<(), Failure> {
    let zstd = written(3);
    seed("container", "zstd", &zstd)?;
    seed("container", "cut", &zstd[..zstd.len() * 3 / 4])?;
    for (name, options) in [
        ("plain", mcap::WriteOptions::new().compression(None)),
        ("lz4", mcap::WriteOptions::new().compression(Some(mcap::Compression::Lz4))),
        ("unchunked", mcap::WriteOptions::new().use_chunks(false)),
    ] {
        let options = options.calculate_chunk_crcs(false);
        let mut writer = options.create(std::io::Cursor::new(Vec::new()))?;
        for message in mcap::MessageStream::new(&zstd)? {
            writer.write(&message?)?;
        }
        writer.finish()?;
        seed("container", name, &writer.into_inner().into_inner())?;
    }
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/recording/fixtures");
    for (at, entry) in fs::read_dir(fixtures)?.enumerate() {
        let entry = entry?;
        if entry.path().extension().is_some_and(|kind| kind == "mcap") && entry.metadata()?.len() <= MOST_BYTES {
            seed("container", &format!("real-{at}"), &fs::read(entry.path())?)?;
        }
    }
    Ok(())
}

fn foxglove() -> Result<Vec<u8>, Failure> {
    let (_, channels) = dialects::foxglove();
    let mut messages = Vec::new();
    for message in mcap::MessageStream::new(&written(4))? {
        let message = message?;
        let at = channels.iter().position(|channel| channel.topic == message.channel.topic);
        messages.push((at.unwrap_or_default(), 25, message.data.to_vec()));
    }
    Ok(input(&messages))
}

/// Plain CDR, little-endian.
#[derive(Default)]
struct Cdr(Vec<u8>);

impl Cdr {
    fn put<const N: usize>(mut self, bytes: [u8; N]) -> Self {
        self.0.resize(self.0.len().next_multiple_of(N), 0);
        self.0.extend(bytes);
        self
    }

    fn text(mut self, text: &str) -> Self {
        self = self.put((text.len() as u32 + 1).to_le_bytes());
        self.0.extend(text.bytes().chain([0]));
        self
    }

    fn doubles(self, values: &[f64]) -> Self {
        values.iter().fold(self, |cdr, value| cdr.put(value.to_le_bytes()))
    }

    fn counted(self, count: usize) -> Self {
        self.put((count as u32).to_le_bytes())
    }

    fn bytes(mut self, bytes: &[u8]) -> Self {
        self = self.counted(bytes.len());
        self.0.extend(bytes);
        self
    }

    fn header(step: u32) -> Self {
        Self::default().put(1_u32.to_le_bytes()).put((step * 100_000_000).to_le_bytes()).text("base")
    }

    fn message(self) -> Vec<u8> {
        [&[0, 1, 0, 0][..], &self.0].concat()
    }
}

fn ros2() -> Vec<u8> {
    let mut messages = Vec::new();
    for step in 0..4 {
        let x = f64::from(step) / 10.0;
        let names = ["c", "a", "b"];
        let joints = names.iter().fold(Cdr::header(step).counted(3), |cdr, name| cdr.text(name));
        let joints = joints.counted(3).doubles(&[x, -x, 1.0]).counted(0).counted(0);
        let color = Cdr::header(step).text("rgb8; jpeg compressed bgr8").bytes(&jpeg());
        let depth = Cdr::header(step).put(SIDE.to_le_bytes()).put(SIDE.to_le_bytes()).text("16UC1").put([0]);
        let depth = depth.put((SIDE * 2).to_le_bytes()).bytes(&[3; 128]);
        messages.push((0, 25, joints.message()));
        messages.push((1, 25, Cdr::header(step).doubles(&[x, x, x, 0.0, 0.0, 0.0, 1.0]).message()));
        messages.push((2, 25, Cdr::header(step).doubles(&[x, 0.0, 0.0, 0.0, 0.0, x]).message()));
        messages.push((3, 15, color.message()));
        messages.push((4, 10, depth.message()));
    }
    input(&messages)
}

/// Images are base64 text: raw depth, color once valid and otherwise damaged.
fn json() -> Vec<u8> {
    let depth = format!(r#""encoding":"16UC1","data":"{}","height":8,"width":8,"step":16"#, "AQI".repeat(57));
    let mut messages = Vec::new();
    for step in 0..4 {
        let stamp = format!(r#""timestamp":{{"sec":1,"nsec":{}}}"#, step * 100_000_000);
        for (channel, rest) in [
            (0, r#""arm":{"position":[1,2,3.5]}"#),
            (1, r#""parts":[{"x":1},{"x":-2e3}]"#),
            (2, r#""values":[true,0.25]"#),
            (3, r#""format":"jpeg","data":"/9j/","on":null"#),
            (4, depth.as_str()),
        ] {
            messages.push((channel, 20, format!("{{{stamp},{rest}}}").into_bytes()));
        }
    }
    input(&messages)
}

fn paths() -> Result<(), Failure> {
    let json = br#"{"name":["b","a"],"position":[1,2],"joints":[{"p":{"x":1}},{"p":{"x":2}}],"deep":[[1],[2,3]]}"#;
    for (at, path) in ["position", "position[0:2]", "joints.p.x", "joints[1].p.x", "deep[1][0:1]"].iter().enumerate() {
        let mut bytes = Vec::new();
        append(&mut bytes, path.as_bytes());
        bytes.extend(json);
        seed("path", &at.to_string(), &bytes)?;
    }
    Ok(())
}

/// Each channel's own schema with its first message.
fn schemas(target: &str, (_, channels): (Dialect, Vec<Channel>), messages: Vec<u8>) -> Result<(), Failure> {
    let mut rest = messages.as_slice();
    for _ in 0..channels.len() {
        let at = usize::from(take(&mut rest, 4)[1]);
        let data = stretch(&mut rest);
        let mut bytes = Vec::new();
        let path = ["joints", "position", "pose.position.x"][at % 3];
        for part in [channels[at].schema_name.as_bytes(), path.as_bytes(), &channels[at].schema] {
            append(&mut bytes, part);
        }
        bytes.extend(data);
        seed(target, &at.to_string(), &bytes)?;
    }
    Ok(())
}

fn jpeg() -> Vec<u8> {
    gleaner_recording::encode_jpeg(&[90, 30, 200].repeat((SIDE * SIDE) as usize), SIDE, SIDE, 80).unwrap_or_default()
}

fn images() -> Result<(), Failure> {
    seed("image", "jpeg", &[&[1][..], &jpeg()].concat())?;
    let rgb: Vec<u8> = (0..SIDE * SIDE * 3).map(|at| at as u8).collect();
    for (name, color) in
        [("l8", ExtendedColorType::L8), ("rgb", ExtendedColorType::Rgb8), ("l16", ExtendedColorType::L16)]
    {
        let mut png = vec![2];
        let pixels = (SIDE * SIDE) as usize * usize::from(color.bits_per_pixel() / 8);
        image::codecs::png::PngEncoder::new(&mut png).write_image(&rgb[..pixels], SIDE, SIDE, color)?;
        seed("image", &format!("png-{name}"), &png)?;
    }
    let mut webp = vec![0];
    image::codecs::webp::WebPEncoder::new_lossless(&mut webp).write_image(&rgb, SIDE, SIDE, ExtendedColorType::Rgb8)?;
    seed("image", "webp", &webp)?;
    seed("image", "rgb8", &[&[3][..], &rgb].concat())?;
    seed("image", "depth16", &[&[4][..], &rgb[..128]].concat())?;
    for kind in 9..18_u8 {
        let size = [SIDE, SIDE, SIDE * 4].map(u32::to_le_bytes).concat();
        seed("image", &format!("raw-{kind}"), &[&[kind][..], &size, &[7; 256]].concat())?;
    }
    Ok(())
}

/// Each file of the datasets of the tests: whole, or with its first bytes written over themselves.
#[cfg(feature = "datasets")]
fn datasets() -> Result<(), Failure> {
    for (at, file) in crate::dataset::files().enumerate() {
        let mut bytes = vec![at as u8];
        if fs::metadata(&file)?.len() <= crate::dataset::MOST_BYTES {
            bytes.extend(fs::read(&file)?);
        } else {
            bytes.extend([0; 3]);
            append(&mut bytes, &fs::read(&file)?[..512]);
        }
        seed("dataset", &at.to_string(), &bytes)?;
    }
    Ok(())
}

/// The header of a checkpoint with one small tensor.
fn checkpoints() -> Result<(), Failure> {
    for (name, policy) in
        [("encoder", ""), ("bc", r#","policy":"bc""#), ("act", r#","policy":"act","act":{"chunk_length":2}"#)]
    {
        let kind = if policy.is_empty() { "encoder" } else { "policy" };
        let header = format!(
            r#"{{"format_version":1,"kind":"{kind}","step":3,"finished":true,"shape":{{"cameras":[{{"name":"top","height":16,"width":16}}],"proprioception":2,"action":1}},"model":{{"preset":"tiny","segment_length":0}}{policy},"spec":"{{}}"}}"#
        );
        let head = serde_json::json!({
            "__metadata__": {"gleaner": header},
            "a.weight": {"dtype": "F32", "shape": [1, 2], "data_offsets": [0, 8]},
        });
        let head = head.to_string();
        seed("checkpoint", name, &[&(head.len() as u64).to_le_bytes()[..], head.as_bytes(), &[0; 8]].concat())?;
    }
    Ok(())
}

/// One field of a protobuf message: its number and its bytes.
fn field(number: u8, bytes: &[u8]) -> Vec<u8> {
    let mut out = vec![number << 3 | 2];
    let mut length = bytes.len();
    while length >= 128 {
        out.push(length as u8 | 128);
        length >>= 7;
    }
    out.push(length as u8);
    [&out, bytes].concat()
}

/// An observation of the task that the server's module for fuzzing uses.
fn observation() -> Vec<u8> {
    const RAW: [u8; 2] = [8, 3];
    let image = |data: &[u8]| [&RAW[..], &field(2, data)].concat();
    let top = [field(1, b"top"), field(2, &image(&[1; 192])), field(3, &image(&[2; 128]))].concat();
    let wrist = [field(1, b"wrist"), field(2, &field(2, &jpeg()))].concat();
    let proprioception: Vec<u8> = [0.5_f32, -0.5].iter().flat_map(|value| value.to_le_bytes()).collect();
    [vec![8, 1], field(2, &top), field(2, &wrist), field(3, &proprioception)].concat()
}

/// For each kind, a message of texts, one of ids, and one of messages.
#[cfg(feature = "server")]
fn messages() -> Result<(), Failure> {
    for kind in 0..gleaner_server::fuzzing::KINDS {
        let id = field(1, b"ep_01ARZ3NDEKTSV4RRFFQ69G5FAV");
        let text = [field(1, b"pick_cube"), field(2, b"x"), vec![24, 1], vec![32, 2]].concat();
        let nested = [field(1, &text), field(2, &field(1, &text)), field(3, &observation())].concat();
        for (name, message) in [("id", id), ("text", text.clone()), ("nested", nested)] {
            seed("wire", &format!("{kind}-{name}"), &[&[kind][..], &message].concat())?;
        }
    }
    Ok(())
}
