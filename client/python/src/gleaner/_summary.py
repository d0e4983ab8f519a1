"""Summary: what a recording states about itself, read from its end, for an early refusal."""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from pathlib import Path
from typing import BinaryIO

from mcap.exceptions import McapError
from mcap.reader import SeekingReader

from gleaner._proto.v1 import episode_pb2 as pb

# The footer record and the closing magic bytes.
_FOOTER = struct.Struct("<BQQQI8s")
_MAGIC = b"\x89MCAP0\r\n"
# A larger record of the summary section is damage.
_MOST_RECORD = 64 << 20


def summarize(path: Path) -> pb.RecordingSummary | None:
    """What a recording states about itself; `None` without a whole and consistent summary section.

    The server inspects every recording, so one without a summary is sent as well.
    """
    try:
        with path.open("rb") as file:
            return _summary(file) if _is_sound(file) else None
    except (McapError, OSError, OverflowError, StopIteration, ValueError, struct.error):
        return None


def _is_sound(file: BinaryIO) -> bool:
    file.seek(-_FOOTER.size, os.SEEK_END)
    footer = file.read()
    _, _, start, _, checksum, magic = _FOOTER.unpack(footer)
    end = file.tell() - _FOOTER.size
    if magic != _MAGIC or not 0 < start < end:
        return False
    # The checksum includes the footer up to the checksum itself.
    file.seek(start)
    found = zlib.crc32(footer[:25], zlib.crc32(file.read(end - start)))
    return checksum in (0, found)


def _summary(file: BinaryIO) -> pb.RecordingSummary | None:
    file.seek(0)
    summary = SeekingReader(file, record_size_limit=_MOST_RECORD).get_summary()
    statistics = summary.statistics if summary else None
    if summary is None or statistics is None:
        return None
    counts = statistics.channel_message_counts
    if sum(counts.values()) != statistics.message_count:
        return None
    topics: Counter[str] = Counter()
    for channel, count in counts.items():
        if channel in summary.channels:
            topics[summary.channels[channel].topic] += count
    chunks = [max(chunk.chunk_length, chunk.uncompressed_size) for chunk in summary.chunk_indexes]
    return pb.RecordingSummary(
        duration_ns=statistics.message_end_time - statistics.message_start_time,
        messages=statistics.message_count,
        channels=statistics.channel_count,
        schemas=statistics.schema_count,
        largest_chunk_bytes=max(chunks, default=0),
        topics=topics,
    )
