"""Reads mutants with the `mcap` library and compares the results with those of gleaner's reader.

Gleaner must refuse each mutant, report a finding, or read exactly what the library reads:

- linear: `NonSeekingReader(validate_crcs=True)`, every message in the file's order, decoded by the libraries for
  protobuf and ROS 2 and by Python's `json`; messages, header stamps, field values and images are compared;
- indexed: `SeekingReader(validate_crcs=True)`, the same messages in any order, where the sound base can be read so.

An accepted mutant without a finding that the library refuses is a difference too, unless gleaner reads the steps of the
sound recording from it ("equal, only here": the damage is in bytes that no step needs). "Undetectable" mutants are read
alike by both and differ from the sound recording: the file holds no evidence of the change.
"""

import argparse
import base64
import collections
import functools
import io
import json
import math
import multiprocessing
import os
import struct
import subprocess
import sys
import tempfile
import zlib
from ctypes import c_float
from pathlib import Path

import bases
from mcap.reader import NonSeekingReader, SeekingReader
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_ros2.decoder import DecoderFactory as Ros2Factory

BATCH = 500
# A header stamp whose seconds or nanoseconds reach this number counts as unset.
MOST_SECONDS = 4e9
# Deaths of the reader in one batch after which the run ends.
MOST_DEATHS = 5
# Prefix of the difference reported for a mutant that the library does not read at all.
REFUSED = "the library refuses it:"


def crc_of(so_far, *parts):
    """CRC-32 over more parts."""
    for part in parts:
        so_far = zlib.crc32(part, so_far)
    return so_far


def get(message, name):
    """A field of a decoded message of any dialect; None when it is absent."""
    if isinstance(message, dict):
        return message.get(name)
    return getattr(message, name, None)


def follow(message, path):
    """The numbers at a path."""
    for name in path.split("."):
        message = get(message, name)
    if isinstance(message, (int, float)):
        return [message]
    return list(message)


def stamp_of(message):
    """The header stamp in nanoseconds; 0 without one."""
    stamp = get(message, "timestamp")
    if stamp is not None and hasattr(message, "HasField") and not message.HasField("timestamp"):
        stamp = None
    if stamp is None:
        header = get(message, "header")
        stamp = get(header, "stamp") if header is not None else None
    if stamp is None:
        return 0
    parts = [
        next((v for v in (get(stamp, n) for n in names) if v is not None), None)
        for names in (("seconds", "sec"), ("nanos", "nanosec", "nsec"))
    ]
    if any(
        part is None or not isinstance(part, (int, float)) or abs(part) >= MOST_SECONDS or part % 1 for part in parts
    ):
        return 0
    return int(parts[0]) * 10**9 + int(parts[1])


def image_of(message):
    """The bytes of an image, which JSON holds as base64."""
    data = get(message, "data")
    if isinstance(data, str):
        return base64.b64decode(data + "=" * (-len(data) % 4), validate=True)
    return bytes(data)


def as_float(value):
    """A value as a 32-bit float's bytes."""
    value = c_float(value).value
    return b"\x00\x00\xc0\x7f" if math.isnan(value) else struct.pack("<f", value)


def decoder():
    """Decodes messages of the three dialects."""
    factories, known = [ProtobufFactory(), Ros2Factory()], {}

    def decode(schema, channel, data):
        if channel.message_encoding == "json":
            return json.loads(data)
        key = (channel.id, schema.id if schema else 0)
        if key not in known:
            found = (factory.decoder_for(channel.message_encoding, schema) for factory in factories)
            known[key] = next(filter(None, found))
        return known[key](data)

    return decode


def linear(data, mapping):
    """Sums over the topics and fields that the library reads from the beginning to the end."""
    topics, fields, decode = {}, {}, decoder()
    wanted = next(one for one in bases.SPEC["mappings"] if one["name"] == mapping)
    images = {topic for camera in wanted["cameras"] for topic in (camera["color"], camera["depth"])}
    used = images | {one["topic"] for one in wanted["fields"]}
    reader = NonSeekingReader(io.BytesIO(data), validate_crcs=True)
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        entry = topics.setdefault(
            channel.topic, {"messages": 0, "ordered": 0, "unordered": 0, "stamps": 0, "images": 0}
        )
        time, length = struct.pack("<Q", message.log_time), struct.pack("<Q", len(message.data))
        entry["messages"] += 1
        entry["ordered"] = crc_of(entry["ordered"], time, length, message.data)
        entry["unordered"] += crc_of(0, time, message.data)
        if channel.topic not in used:
            continue
        decoded = decode(schema, channel, message.data)
        entry["stamps"] = crc_of(entry["stamps"], struct.pack("<q", stamp_of(decoded)))
        if channel.topic in images:
            entry["images"] = crc_of(entry["images"], image_of(decoded))
        for source in (one for one in wanted["fields"] if one["topic"] == channel.topic):
            values = [value for path in source["paths"] for value in follow(decoded, path)]
            if source.get("names"):
                by_name = dict(reversed(list(zip(get(decoded, "name"), values, strict=True))))
                if not all(name in by_name for name in source["names"]):
                    continue
                values = [by_name[name] for name in source["names"]]
            count, so_far = fields.get(source["field"], (0, 0))
            fields[source["field"]] = (count + 1, crc_of(so_far, *map(as_float, values)))
    return topics, fields


def indexed(data):
    """Number and sum of each topic's messages, read through the index."""
    topics = {}
    for _, channel, message in SeekingReader(io.BytesIO(data), validate_crcs=True).iter_messages():
        count, total = topics.get(channel.topic, (0, 0))
        topics[channel.topic] = (count + 1, total + crc_of(0, struct.pack("<Q", message.log_time), message.data))
    return topics


@functools.cache
def has_index(base):
    """Whether the library can read a sound base through its index; the summary must repeat the channels for that."""
    try:
        indexed(Path(base).read_bytes())
    except KeyError:
        return False
    return True


def differences(entry, data, base):
    """The differences between gleaner's and the library's reading of an accepted mutant."""
    ours, found = entry["sums"], []
    topics_of = {topic: sums for topic, sums in ours["topics"].items() if sums["messages"]}
    # Any exception of the library counts as its refusal.
    try:
        topics, fields = linear(data, entry["read_as"])
    except Exception as error:
        return [f"{REFUSED} linear: {type(error).__name__}: {error}"]
    if topics != topics_of:
        wrong = [topic for topic in topics.keys() | topics_of.keys() if topics.get(topic) != topics_of.get(topic)]
        found += [f"linear: {each}: gleaner {topics_of.get(each)}, the library {topics.get(each)}" for each in wrong]
    our_fields = {name: tuple(sums) for name, sums in ours["fields"].items()}
    if fields != our_fields:
        found.append(f"linear: fields: gleaner {our_fields}, the library {fields}")
    if not has_index(base):
        return found
    try:
        by_index = indexed(data)
    except Exception as error:
        return [*found, f"{REFUSED} indexed: {type(error).__name__}: {error}"]
    if by_index != {topic: (sums["messages"], sums["unordered"]) for topic, sums in topics_of.items()}:
        found.append("indexed: the messages differ")
    return found


def verdict(entry, data, base):
    """The class of a mutant, and its problems."""
    if entry["outcome"] == "refused":
        return "refused", []
    if entry["outcome"] == "panicked":
        return "DIFFERENT", ["the reader panicked"]
    if entry["findings"]:
        return ("finding, same steps" if entry["same"] else "finding"), []
    wrong = differences(entry, data, base)
    if wrong and entry["same"] and all(one.startswith(REFUSED) for one in wrong):
        return "equal, only here", []
    if wrong:
        return "DIFFERENT", wrong
    return ("equal" if entry["same"] else "equal, undetectable"), []


def offer(corpus, damage, outcome, data):
    """Keeps a mutant whose damage and outcome are new to the corpus, or that is smaller than the file already kept."""
    corpus.mkdir(parents=True, exist_ok=True)
    path = corpus / f"{damage}-{outcome}"
    if not path.exists() or path.stat().st_size > len(data) > 0:
        path.write_bytes(data)


def batch(job):
    """Makes and judges some mutants. A reader that aborts is restarted after the mutant that ended it."""
    program, folder, first, count, seed, keep, corpus = job
    results, end, deaths = [], first + count, 0
    while first < end:
        command = [program, folder, str(first), str(end - first), str(seed)]
        child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        while head := child.stdout.read(4):
            entry = json.loads(child.stdout.read(struct.unpack("<I", head)[0]))
            data = child.stdout.read(struct.unpack("<I", child.stdout.read(4))[0])
            kind, wrong = verdict(entry, data, str(Path(folder, f"{entry['base']}.mcap")))
            if wrong:
                Path(keep, f"{entry['base']}-{entry['kind']}-{entry['id']}.mcap").write_bytes(data)
            results.append((entry["id"], entry["base"], entry["kind"], kind, wrong))
            if corpus:
                offer(Path(corpus), entry["kind"], kind.split(",")[0], data)
            first = entry["id"] + 1
        if child.wait() != 0:
            deaths += 1
            if deaths > MOST_DEATHS:
                raise RuntimeError(f"{' '.join(command)} ends with {child.returncode}; run it to see the cause")
            results.append((first, "?", "?", "DIFFERENT", [f"the reader ended with {child.returncode}"]))
            first += 1
    return results


def table(title, rows, columns):
    """Prints counts."""
    print(f"\n{title:<24}" + "".join(f"{column:>20}" for column in columns))
    for name, counts in sorted(rows.items()):
        print(f"{name:<24}" + "".join(f"{counts[column]:>20}" for column in columns))


def main():
    """Runs the suite; the exit status is 1 when a mutant is read differently without a finding."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", required=True, help="the built example `mutants`")
    parser.add_argument("--mutants", type=int, default=2000, help="number of mutants (default 2000)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the mutants (default 1)")
    parser.add_argument("--keep", default=None, help="folder for mutants that are read differently")
    parser.add_argument("--steps", type=int, default=14, help="steps of each sound recording (default 14)")
    parser.add_argument("--corpus", default=None, help="folder for the smallest mutant of each damage and outcome")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes (default: one per core)")
    options = parser.parse_args()
    keep = options.keep or tempfile.mkdtemp(prefix="gleaner-differential-")
    Path(keep).mkdir(parents=True, exist_ok=True)
    by_dialect, by_kind = collections.defaultdict(collections.Counter), collections.defaultdict(collections.Counter)
    wrong, total = [], collections.Counter()
    with tempfile.TemporaryDirectory() as folder, multiprocessing.Pool(options.jobs) as pool:
        bases.write_bases(folder, options.steps)
        program = str(Path(options.program).resolve())
        jobs = [
            (program, folder, first, min(BATCH, options.mutants - first), options.seed, keep, options.corpus)
            for first in range(0, options.mutants, BATCH)
        ]
        for results in pool.imap_unordered(batch, jobs):
            for number, base, kind, outcome, problems in results:
                by_dialect[base][outcome] += 1
                by_kind[kind][outcome] += 1
                total[outcome] += 1
                if problems:
                    wrong.append((number, base, kind, problems))
    columns = [
        "refused",
        "finding",
        "finding, same steps",
        "equal",
        "equal, undetectable",
        "equal, only here",
        "DIFFERENT",
    ]
    table("base", by_dialect, columns)
    table("damage", by_kind, columns)
    table("", {"all": total}, columns)
    for number, base, kind, problems in sorted(wrong)[:40]:
        print(f"mutant {number}, {base}, {kind}: {'; '.join(problems)[:600]}")
    if wrong:
        print(f"{len(wrong)} mutants are read differently without a finding; they are in {keep}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
