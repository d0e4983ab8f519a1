"""What two processes of one thread gain on one, with the same total batch: gleaner's ranks beside PyTorch's
DistributedDataParallel, both by gloo, in turns in one run.

The efficiency of two ranks is the time of one process over twice theirs. gleaner's must be at least 0.9 of PyTorch's.
"""

import argparse
import contextlib
import json
import statistics
import sys
import tempfile
from pathlib import Path

from compare import CASES, Worker, eager, ours, worker

RANKS = 2
LEAST = 0.9


@contextlib.contextmanager
def our_ranks(program: Path, job: dict):
    """Rank 0, which takes the others along."""
    with contextlib.ExitStack() as stack:
        first = stack.enter_context(ours(program, {**job, "ranks": RANKS}))
        for rank in range(1, RANKS):
            follower = {**job, "ranks": RANKS, "rank": rank, "meeting": first.meeting, "share": None}
            # It writes nothing, so it is not waited for.
            stack.enter_context(worker([str(program), json.dumps(follower, default=str)], reports_size=False))
        yield first


class Together:
    """Ranks that are each paced; the step takes what rank 0 took."""

    def __init__(self, ranks: list[Worker]):
        self.ranks = ranks

    def take(self, count: int) -> dict:
        for rank in self.ranks:
            rank.ask(count)
        return [rank.answer() for rank in self.ranks][0]


@contextlib.contextmanager
def eager_ranks(job: dict):
    meeting = Path(job["share"]) / "meeting"
    meeting.unlink(missing_ok=True)
    with contextlib.ExitStack() as stack:
        ranks = [
            worker(eager({**job, "ranks": RANKS, "rank": rank, "meeting": meeting}, "once", "f32"), reports_size=False)
            for rank in range(RANKS)
        ]
        ranks = [stack.enter_context(rank) for rank in ranks]
        # Each says its size only once all have met.
        for rank in ranks:
            rank.parameters = rank.answer()["parameters"]
        yield Together(ranks)


def measure(program: Path, case: dict, rounds: int, block: int) -> dict[str, list[float]]:
    """The efficiency in each round."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        job = {**case, "threads": 1, "share": Path(folder)}
        # The first one writes the episodes and the weights that the others begin from.
        contenders = {"gleaner": [stack.enter_context(ours(program, job))]}
        contenders["gleaner"].append(stack.enter_context(our_ranks(program, job)))
        alone = stack.enter_context(worker(eager(job, "once", "f32")))
        contenders["DistributedDataParallel"] = [alone, stack.enter_context(eager_ranks(job))]
        both = [one for pair in contenders.values() for one in pair]
        for one in both:
            one.take(3)
        found = {name: [] for name in contenders}
        times = {name: [] for name in contenders}
        for _ in range(rounds):
            for name, pair in contenders.items():
                alone, shared = (statistics.median(one.take(block)["ms"]) for one in pair)
                found[name].append(alone / (RANKS * shared))
                times[name].append((alone, shared))
    for name, pairs in times.items():
        alone, shared = (statistics.median(each) for each in zip(*pairs))
        print(f"  {name}: {alone:.1f} ms alone, {shared:.1f} ms with {RANKS} ranks", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("program", type=Path, help="the learn crate's `steps` bench")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--block", type=int, default=5, help="steps in a round")
    options = parser.parse_args()
    missed = False
    for name in options.cases:
        print(f"{name}, {RANKS} ranks of one thread:")
        found = measure(options.program, CASES[name], options.rounds, options.block)
        for contender, each in found.items():
            print(f"  {contender}: efficiency {statistics.median(each):.3f} ({min(each):.3f} to {max(each):.3f})")
        ratio = statistics.median(found["gleaner"]) / statistics.median(found["DistributedDataParallel"])
        met = ratio >= LEAST
        missed |= not met
        print(f"  ratio {ratio:.3f}, at least {LEAST}: {'met' if met else 'MISSED'}", flush=True)
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
