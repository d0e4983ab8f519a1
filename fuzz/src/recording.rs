//! Recordings with the messages of an input in a valid container. In a whole file, checksums would reject nearly every
//! change.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::PathBuf;
use std::sync::LazyLock;

use gleaner_recording::{Reading, RecordingError, TaskSpec, read_episode, salvage};
use mcap::records::MessageHeader;

use crate::{append, number, stretch, take, task};

/// One channel of a dialect.
pub struct Channel {
    pub topic: &'static str,
    pub schema_name: &'static str,
    pub schema: Vec<u8>,
}

/// The encodings of a dialect's messages and schemas.
#[derive(Clone, Copy)]
pub struct Dialect {
    pub message_encoding: &'static str,
    pub schema_encoding: &'static str,
}

static TASK: LazyLock<TaskSpec> = LazyLock::new(task::task);

/// One file for each process, in the temporary directory.
static FILE: LazyLock<PathBuf> = LazyLock::new(|| file_name(""));
static REPAIRED: LazyLock<PathBuf> = LazyLock::new(|| file_name("-repaired"));

fn file_name(part: &str) -> PathBuf {
    std::env::temp_dir().join(format!("gleaner-fuzz-{}{part}.mcap", std::process::id()))
}

/// Reads a whole file as an episode, as an upload is.
pub fn read(bytes: &[u8]) {
    std::fs::write(&*FILE, bytes).expect("the temporary directory is writable");
    check(read_episode(&FILE, &TASK));
}

/// Salvages a file like a damaged rollout; the result is complete.
pub fn salvage_and_read(bytes: &[u8]) {
    std::fs::write(&*FILE, bytes).expect("the temporary directory is writable");
    if salvage(&FILE, &REPAIRED).is_ok() {
        let damaged = matches!(read_episode(&REPAIRED, &TASK), Err(RecordingError::Damaged { .. }));
        assert!(!damaged, "a salvaged recording is damaged");
    }
}

fn check(reading: Result<Reading, RecordingError>) {
    match reading {
        Ok(Reading { episode, report, .. }) => {
            let steps = episode.steps();
            assert!(steps >= 2 && report.steps == steps as u64, "{report:?}");
            assert_eq!(episode.proprioception().len(), steps * TASK.proprioception_size());
            assert_eq!(episode.action().len(), steps * TASK.action_size());
            assert!(episode.action().iter().all(|value| value.is_finite()), "{report:?}");
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// Writes the messages of an input into a file and reads it. A message is a byte of flags (bit 7: with its own schema) and
/// the channel, two bytes of milliseconds, and a stretch.
pub fn wrap_and_read(dialect: Dialect, channels: &[Channel], mut input: &[u8]) {
    let options = mcap::WriteOptions::new().compression(None).chunk_size(Some(1 << 12));
    let Ok(mut writer) = options.create(Cursor::new(Vec::new())) else { return };
    let mut time = 0;
    let mut ids: Vec<Option<u16>> = vec![None; channels.len()];
    while !input.is_empty() && !channels.is_empty() {
        let flags = number(&mut input, 1);
        let at = number(&mut input, 1) as usize % channels.len();
        time += number(&mut input, 2) * 1_000_000;
        let own_schema = flags >= 128;
        if own_schema || ids[at].is_none() {
            let schema = if own_schema { stretch(&mut input) } else { &channels[at].schema };
            ids[at] = declare(&mut writer, dialect, &channels[at], schema);
        }
        let data = stretch(&mut input);
        let Some(channel_id) = ids[at] else { continue };
        let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        let _ = writer.write_to_known_channel(&header, data);
    }
    if writer.finish().is_ok() {
        read(&writer.into_inner().into_inner());
    }
}

fn declare(
    writer: &mut mcap::Writer<Cursor<Vec<u8>>>,
    dialect: Dialect,
    channel: &Channel,
    schema: &[u8],
) -> Option<u16> {
    let schema = match dialect.schema_encoding {
        "" => 0,
        encoding => writer.add_schema(channel.schema_name, encoding, schema).ok()?,
    };
    writer.add_channel(schema, channel.topic, dialect.message_encoding, &BTreeMap::new()).ok()
}

/// The input of [`wrap_and_read`] for these messages: (channel, milliseconds after the previous one, bytes).
pub fn input(messages: &[(usize, u16, Vec<u8>)]) -> Vec<u8> {
    let mut out = Vec::new();
    for (channel, after, data) in messages {
        out.extend([0, *channel as u8]);
        out.extend(after.to_le_bytes());
        append(&mut out, data);
    }
    out
}

/// The channels of ROS 2, of a foxglove bridge and of plain JSON.
pub mod dialects {
    use super::*;

    /// The dialect of gleaner's own writer, with the schemas of a recording by it.
    pub fn foxglove() -> (Dialect, Vec<Channel>) {
        let bytes = crate::task::written(2);
        let summary = mcap::Summary::read(&bytes).ok().flatten().expect("the writer's files have a summary");
        let topics = ["/camera/front/color", "/camera/front/depth", "/robot/state", "/robot/action"];
        let channel = |topic: &'static str| {
            let found = summary.channels.values().find(|channel| channel.topic == topic).expect("the topic is written");
            let schema = found.schema.as_ref().expect("protobuf has a schema");
            let name: &'static str = Box::leak(schema.name.clone().into_boxed_str());
            Channel { topic, schema_name: name, schema: schema.data.to_vec() }
        };
        (Dialect { message_encoding: "protobuf", schema_encoding: "protobuf" }, topics.map(channel).into())
    }

    pub fn ros2() -> (Dialect, Vec<Channel>) {
        let channel = |(topic, schema_name, schema): (&'static str, &'static str, &str)| Channel {
            topic,
            schema_name,
            schema: schema.replace("---", &"=".repeat(80)).into_bytes(),
        };
        (Dialect { message_encoding: "cdr", schema_encoding: "ros2msg" }, ROS2.map(channel).into())
    }

    pub fn json() -> (Dialect, Vec<Channel>) {
        let topics = ["/json/joints", "/json/tool", "/json/command", "/json/front/color", "/json/front/depth"];
        let channel = |topic| Channel { topic, schema_name: "", schema: Vec::new() };
        (Dialect { message_encoding: "json", schema_encoding: "" }, topics.map(channel).into())
    }

    const ROS2: [(&str, &str, &str); 5] = [
        (
            "/joint_states",
            "sensor_msgs/msg/JointState",
            "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
        ),
        (
            "/tool_pose",
            "geometry_msgs/msg/PoseStamped",
            "std_msgs/Header header\nPose pose\n---\nMSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n---\n\
             MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n---\n\
             MSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
        ),
        (
            "/command",
            "geometry_msgs/msg/TwistStamped",
            "std_msgs/Header header\nTwist twist\n---\nMSG: geometry_msgs/Twist\nVector3 linear\nVector3 angular\n---\n\
             MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z",
        ),
        ("/front/color", "sensor_msgs/msg/CompressedImage", "std_msgs/Header header\nstring format\nuint8[] data"),
        (
            "/front/depth",
            "sensor_msgs/msg/Image",
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n\
             uint8[] data",
        ),
    ];
}

/// The stretches of an input, for targets that need a schema and a message.
pub fn stretches<const N: usize>(mut input: &[u8]) -> [&[u8]; N] {
    std::array::from_fn(|at| if at + 1 == N { take(&mut input, usize::MAX) } else { stretch(&mut input) })
}
