"""Rows of episodes and their labels, inserted in bulk: the only SQL of the benches that writes."""

import pathlib
import random
import sqlite3
import time
from collections.abc import Iterable

CROCKFORD = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
DAY = 86_400_000
# Of an ordinary lab.
OUTCOMES = ["success", "failure", "failure", "unknown"]


def ulid(millis: int, random_bits: random.Random) -> str:
    number = millis << 80 | random_bits.getrandbits(80)
    return "".join(CROCKFORD[number >> shift & 31] for shift in range(125, -1, -5))


def add_episodes(
    rows: sqlite3.Connection,
    task: str,
    report: str,
    recordings: Iterable[tuple[str, int]],
    steps: int,
    outcomes: list[str],
    chance: random.Random,
) -> Iterable[tuple[str, str, str]]:
    """Adds an episode with its label for each recording, given by digest and size, and yields its id, outcome and cohort."""
    begin = int(time.time() * 1000) - 40 * DAY
    for number, (digest, size) in enumerate(recordings):
        at = begin + number * 30_000
        episode = f"ep_{ulid(at, chance)}"
        outcome, cohort = chance.choice(outcomes), f"cohort_{chance.randrange(12)}"
        rows.execute(
            "insert into episodes (id, task_id, file_name, recording, size_bytes, steps, duration_s, mapping, warnings,"
            " report, outcome, cohort, created_at) values (?, ?, ?, ?, ?, ?, ?, 'gleaner', ?, ?, ?, ?, ?)",
            [episode, task, f"{number:06}.mcap", digest, size, steps, steps / 10, chance.randrange(3), report, outcome,
             cohort, at],
        )
        rows.execute(
            "insert into labels (episode_id, outcome, cohort, author, reason, created_at) values (?, ?, ?, 'bench', '', ?)",
            [episode, outcome, cohort, at],
        )
        yield episode, outcome, cohort


def connect(data: pathlib.Path) -> sqlite3.Connection:
    """The database of a data folder whose server is stopped."""
    return sqlite3.connect(data / "gleaner.db")
