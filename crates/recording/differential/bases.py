"""Writes the sound recordings that mutants are made of: each dialect in each layout of the container.

They are written by the `mcap` library, so that the reader under test reads files of another implementation.
"""

import base64
import json
import math
import struct
import zlib
from pathlib import Path

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap.writer import CompressionType, Writer
from mcap_ros2._dynamic import serialize_dynamic

WIDTH, HEIGHT = 16, 8
START = 1_700_000_000_000_000_000

# Name, then arguments of the writer. Chunks hold a few steps each.
LAYOUTS = {
    "zstd": {"compression": CompressionType.ZSTD, "chunk_size": 1500, "enable_data_crcs": True},
    "lz4": {"compression": CompressionType.LZ4, "chunk_size": 1500},
    "plain": {"compression": CompressionType.NONE, "chunk_size": 2500, "enable_data_crcs": True},
    "nocrc": {"compression": CompressionType.NONE, "chunk_size": 2500, "enable_crcs": False},
    "unchunked": {"use_chunking": False, "enable_data_crcs": True},
    "unchunkednocrc": {"use_chunking": False, "enable_crcs": False},
    "bare": {
        "compression": CompressionType.ZSTD,
        "chunk_size": 1500,
        "use_statistics": False,
        "use_summary_offsets": False,
        "repeat_schemas": False,
        "repeat_channels": False,
    },
}

SEPARATOR = "=" * 80
HEADER = f"""
{SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
ROS2_SCHEMAS = {
    "sensor_msgs/msg/JointState": "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
    "float64[] effort" + HEADER,
    "geometry_msgs/msg/PointStamped": "std_msgs/Header header\nPoint point"
    + HEADER
    + f"{SEPARATOR}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/TwistStamped": "std_msgs/Header header\nTwist twist"
    + HEADER
    + f"{SEPARATOR}\nMSG: geometry_msgs/Twist\nVector3 linear\nVector3 angular\n"
    + f"{SEPARATOR}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n",
    "sensor_msgs/msg/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data" + HEADER,
    "sensor_msgs/msg/Image": "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
    "uint8 is_bigendian\nuint32 step\nuint8[] data" + HEADER,
}


SPEC = json.loads((Path(__file__).parent / "task.json").read_text())


def png(step):
    """A small color image as PNG: red follows the step."""
    rows = b"".join(b"\0" + bytes([step * 7 % 256, row * 20, 90]) * WIDTH for row in range(HEIGHT))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", WIDTH, HEIGHT, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def depth(step):
    """A small depth image in millimetres."""
    return struct.pack("<H", 500 + step) * (WIDTH * HEIGHT)


def numbers(step):
    """Joint positions, tool and command of a step."""
    return [math.sin(step / 3), -step / 7], step / 10, [step / 5, math.cos(step)]


def field(number, name, kind, label=1, type_name=None):
    """A field of a protobuf message."""
    return descriptor_pb2.FieldDescriptorProto(name=name, number=number, type=kind, label=label, type_name=type_name)


def protobuf_messages():
    """Message classes by full name, and the serialized descriptors of them all."""
    stamp = field(1, "timestamp", 11, type_name=".google.protobuf.Timestamp")
    text, raw, fixed, double = 9, 12, 7, 1
    types = {
        "CompressedImage": [field(2, "data", raw), field(3, "format", text), field(4, "frame_id", text)],
        "RawImage": [
            field(2, "width", fixed),
            field(3, "height", fixed),
            field(4, "encoding", text),
            field(5, "step", fixed),
            field(6, "data", raw),
            field(7, "frame_id", text),
        ],
        "State": [field(2, "joint_position", double, 3), field(3, "tool", 2)],
        "Action": [field(2, "command", double, 3)],
    }
    file = descriptor_pb2.FileDescriptorProto(
        name="differential.proto",
        package="foxglove",
        syntax="proto3",
        dependency=["google/protobuf/timestamp.proto"],
        message_type=[descriptor_pb2.DescriptorProto(name=name, field=[stamp, *rest]) for name, rest in types.items()],
    )
    stamp_file = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp_file)
    pool = descriptor_pool.DescriptorPool()
    for each in (stamp_file, file):
        pool.Add(each)
    described = descriptor_pb2.FileDescriptorSet(file=[stamp_file, file]).SerializeToString()
    names = [f"foxglove.{name}" for name in types]
    return {name: message_factory.GetMessageClass(pool.FindMessageTypeByName(name)) for name in names}, described


def foxglove(steps):
    """Messages in protobuf: topic, schema's name, schema's encoding, schema, message encoding, step, bytes."""
    classes, described = protobuf_messages()
    for step in range(steps):
        joints, tool, command = numbers(step)
        stamp = {"seconds": (START + step * 10**8) // 10**9, "nanos": (START + step * 10**8) % 10**9}
        size = {"width": WIDTH, "height": HEIGHT, "step": WIDTH * 2}
        for topic, name, values in [
            ("color", "CompressedImage", {"data": png(step), "format": "png"}),
            ("depth", "RawImage", {**size, "encoding": "16UC1", "data": depth(step)}),
            ("state", "State", {"joint_position": joints, "tool": tool}),
            ("action", "Action", {"command": command}),
        ]:
            message = classes[f"foxglove.{name}"](**values)
            message.timestamp.seconds, message.timestamp.nanos = stamp["seconds"], stamp["nanos"]
            data = message.SerializeToString()
            yield f"/foxglove/{topic}", f"foxglove.{name}", "protobuf", described, "protobuf", step, data


def ros2(steps):
    """Messages in CDR."""
    encoders = {name: serialize_dynamic(name, text)[name] for name, text in ROS2_SCHEMAS.items()}
    for step in range(steps):
        joints, tool, command = numbers(step)
        time = START + step * 10**8
        header = {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": "base"}
        size = {"width": WIDTH, "height": HEIGHT, "step": WIDTH * 2, "is_bigendian": 0, "encoding": "16UC1"}
        vector = {"x": 0.0, "y": 0.0, "z": 0.0}
        joints = {"name": ["b", "a"], "position": joints[::-1], "velocity": [], "effort": []}
        twist = {"linear": {**vector, "x": command[0]}, "angular": {**vector, "z": command[1]}}
        for topic, name, values in [
            ("color", "sensor_msgs/msg/CompressedImage", {"format": "png", "data": png(step)}),
            ("depth", "sensor_msgs/msg/Image", {**size, "data": depth(step)}),
            ("joints", "sensor_msgs/msg/JointState", joints),
            ("tool", "geometry_msgs/msg/PointStamped", {"point": {**vector, "x": tool}}),
            ("action", "geometry_msgs/msg/TwistStamped", {"twist": twist}),
        ]:
            data = encoders[name]({"header": header, **values})
            yield f"/ros2/{topic}", name, "ros2msg", ROS2_SCHEMAS[name].encode(), "cdr", step, data


def plain_json(steps):
    """Messages in JSON, whose images are base64 text."""
    for step in range(steps):
        joints, tool, command = numbers(step)
        time = START + step * 10**8
        stamp = {"timestamp": {"sec": time // 10**9, "nsec": time % 10**9}}
        size = {"width": WIDTH, "height": HEIGHT, "step": WIDTH * 2, "encoding": "16UC1"}
        for topic, values in [
            ("color", {"format": "png", "data": base64.b64encode(png(step)).decode()}),
            ("depth", {**size, "data": base64.b64encode(depth(step)).decode()}),
            ("joints", {"position": joints}),
            ("tool", {"x": tool}),
            ("action", {"values": command}),
        ]:
            yield f"/json/{topic}", "", "", b"", "json", step, json.dumps({**stamp, **values}).encode()


DIALECTS = {"foxglove": foxglove, "ros2": ros2, "json": plain_json}


def write_base(path, messages, layout):
    """Writes one recording."""
    with path.open("wb") as file:
        writer = Writer(file, **layout)
        writer.start(profile="", library="differential")
        schemas, channels = {}, {}
        for topic, name, schema_encoding, schema, encoding, step, data in messages:
            if topic not in channels:
                if name and name not in schemas:
                    schemas[name] = writer.register_schema(name, schema_encoding, schema)
                channels[topic] = writer.register_channel(topic, encoding, schemas.get(name, 0))
            time = START + step * 10**8
            writer.add_message(channels[topic], time, data, time, step)
        writer.add_metadata("session", {"operator": "tester"})
        writer.add_attachment(START, START, "note.txt", "text/plain", b"attached")
        writer.finish()


def write_bases(folder, steps):
    """Writes the task and every recording, each with the given number of steps, to a folder."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.mcap"):
        old.unlink()
    (folder / "spec.json").write_text(json.dumps(SPEC))
    for dialect, messages in DIALECTS.items():
        for name, layout in LAYOUTS.items():
            write_base(folder / f"{dialect}-{name}.mcap", messages(steps), layout)
