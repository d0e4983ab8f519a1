"""The topics of an MCAP file that a viewer should show: pictures, and gleaner's scores. Knows no viewer."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader

from gleaner.errors import invalid

_PICTURES = (
    "foxglove.CompressedImage",
    "foxglove.CompressedVideo",
    "foxglove.RawImage",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/Image",
)
# Topics of scores with the numbers to plot in them: exports have the first, or beside ROS messages the others.
_SCORES = {"/gleaner/quality": ("q", "w"), "/gleaner/q": ("data",), "/gleaner/w": ("data",)}


@dataclass(frozen=True)
class Number:
    """A number in a topic's messages."""

    topic: str
    schema: str
    path: str

    @property
    def name(self) -> str:
        """What a legend calls it: q or w."""
        return self.topic.rpartition("/")[2] if self.path == "data" else self.path


@dataclass(frozen=True)
class Topics:
    """What there is to show, in the order of names."""

    pictures: list[str] = field(default_factory=list)
    scores: list[Number] = field(default_factory=list)


def topics(path: Path) -> Topics:
    """The topics of a recording. Raises `InvalidArgument` when it is no MCAP file with a summary, or has none."""
    try:
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
    except (OSError, McapError) as error:
        raise invalid("path", f"{path} cannot be read as MCAP: {error}") from None
    if summary is None:
        raise invalid("path", f"{path} has no summary; export it again, or repair it with the tool `mcap recover`")
    found = Topics()
    for channel in sorted(summary.channels.values(), key=lambda channel: channel.topic):
        schema = summary.schemas.get(channel.schema_id)
        if schema is None:
            continue
        if schema.name in _PICTURES:
            found.pictures.append(channel.topic)
        paths = _SCORES.get(channel.topic, ())
        found.scores.extend(Number(channel.topic, schema.name, path) for path in paths)
    if not found.pictures and not found.scores:
        raise invalid("path", f"{path} has neither pictures nor scores of gleaner to show")
    return found
