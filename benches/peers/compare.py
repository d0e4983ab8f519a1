"""Our pretraining step beside eager PyTorch's: takes turns in one run, checks that both train the same
model, and prints the ratios.
"""

import argparse
import contextlib
import itertools
import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).parent
# The most our step may cost in each precision, in units of each peer's: how it encodes, and its precision.
TARGETS = {
    "f32": {("once", "f32"): 1.1, ("window", "f32"): 0.5},
    "bf16": {("once", "f32"): 0.7, ("once", "bf16"): 0.9},
}
CASES = {
    "tiny": {"preset": "tiny", "side": 32, "depth": False, "episodes": 16},
    "small": {"preset": "small", "side": 128, "depth": True, "episodes": 8},
}
# Every segment of one episode in every batch, and no mask: both programs' losses must then be the same.
SAME_LOSS = {"objectives": ["aa"], "episodes": 1, "batch": 100, "stretch": 100}
TOLERANCE = 1e-5


@dataclass
class Worker:
    """A program that takes steps on request."""

    process: subprocess.Popen
    parameters: int = 0
    # The port at which further ranks find this one.
    meeting: int = 0
    ms: list[list[float]] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)
    waited_ms: list[float] = field(default_factory=list)

    def answer(self) -> dict:
        line = self.process.stdout.readline()
        if not line:
            sys.exit(f"peers: {self.process.args[0]} ended early, with {self.process.wait()}")
        return json.loads(line)

    def ask(self, count: int) -> None:
        self.process.stdin.write(f"{count}\n")
        self.process.stdin.flush()

    def take(self, count: int) -> dict:
        before = self.cpu()
        self.ask(count)
        taken = self.answer()
        for all_blocks, now, then in zip((self.cpu_ms, self.waited_ms), self.cpu(), before):
            all_blocks.append((now - then) / count)
        self.ms.append(taken["ms"])
        return taken

    def cpu(self) -> tuple[float, float]:
        """Milliseconds its threads have had a processor, and have waited for one that others had."""
        threads = Path(f"/proc/{self.process.pid}/task").glob("*/schedstat")
        both = [thread.read_text().split()[:2] for thread in threads]
        return sum(int(ran) for ran, _ in both) / 1e6, sum(int(waited) for _, waited in both) / 1e6

    def waited(self) -> float:
        """The share of the time its threads were ready in which they had to wait. Threads that wait for
        each other make that worse than it looks: far above 0, the clock has little meaning."""
        return sum(self.waited_ms) / (sum(self.waited_ms) + sum(self.cpu_ms))

    def forget(self) -> None:
        """Discards the measurements so far."""
        for blocks in (self.ms, self.cpu_ms, self.waited_ms):
            blocks.clear()

    def median(self) -> float:
        return statistics.median(ms for block in self.ms for ms in block)


@contextlib.contextmanager
def worker(command: list[str], reports_size: bool = True) -> Iterator[Worker]:
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        started = Worker(process)
        if reports_size:
            said = started.answer()
            started.parameters, started.meeting = said["parameters"], said.get("meeting", 0)
        yield started
    finally:
        process.kill()
        process.wait()


def ours(program: Path, job: dict) -> contextlib.AbstractContextManager[Worker]:
    return worker([str(program), json.dumps(job, default=str)])


def eager(job: dict, encode: str, precision: str) -> list[str]:
    """The command of a peer."""
    words = []
    for name, value in {**job, "precision": precision}.items():
        if value is True:
            words.append(f"--{name}")
        elif value is not False:
            words.append(f"--{name}={','.join(value) if isinstance(value, list) else value}")
    return [sys.executable, str(HERE / "pretrain_step.py"), "--paced", f"--encode={encode}", *words]


def check_same(program: Path, case: dict) -> float:
    """Takes the same five steps in each program; the largest relative difference of their losses."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        job = {**case, **SAME_LOSS, "threads": 1, "share": Path(folder)}
        first = stack.enter_context(ours(program, job))
        losses = first.take(5)["loss"]
        worst = 0.0
        for encode, precision in TARGETS["f32"]:
            peer = stack.enter_context(worker(eager(job, encode, precision)))
            if peer.parameters != first.parameters:
                sys.exit(f"peers: {first.parameters} parameters, the peer has {peer.parameters}")
            found = peer.take(5)["loss"]
            worst = max([worst] + [abs(a - b) / abs(a) for a, b in zip(losses, found)])
    if not worst <= TOLERANCE:
        sys.exit(f"peers: the losses differ by {worst:.1e} of their size: not the same model")
    return worst


def measure(program: Path, case: dict, precision: str, threads: int, rounds: int, block: int) -> dict:
    """Blocks of steps of each program in turn, after one to warm up."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        job = {**case, "precision": precision, "threads": threads, "share": Path(folder)}
        workers = {"ours": stack.enter_context(ours(program, job))}
        workers |= {peer: stack.enter_context(worker(eager(job, *peer))) for peer in TARGETS[precision]}
        sizes = {one.parameters for one in workers.values()}
        if len(sizes) != 1:
            sys.exit(f"peers: the models have different numbers of parameters: {sizes}")
        for one in workers.values():
            one.take(3)
            one.forget()
        for _ in range(rounds):
            for one in workers.values():
                one.take(block)
    first = workers.pop("ours")
    return {
        "parameters": first.parameters,
        "ms": first.median(),
        "cpu_ms": statistics.median(first.cpu_ms),
        "waited": first.waited(),
        "peers": {named(*key): beside(first, peer) for key, peer in workers.items()},
    }


def named(encode: str, precision: str) -> str:
    """A peer in words."""
    return f"PyTorch in {precision}, each frame {'once' if encode == 'once' else 'in every window'}"


def beside(first: Worker, peer: Worker) -> dict:
    """The peer's cost and ours in units of it: by the clock, and by processor time. Each round gives one
    ratio, of steps taken within seconds of each other; the result is the median."""
    clock = [statistics.median(a) / statistics.median(b) for a, b in zip(first.ms, peer.ms)]
    cpu = [a / b for a, b in zip(first.cpu_ms, peer.cpu_ms)]
    return {
        "ms": peer.median(),
        "cpu_ms": statistics.median(peer.cpu_ms),
        "waited": peer.waited(),
        "ratio": statistics.median(clock),
        "ratio_least": min(clock),
        "ratio_most": max(clock),
        "cpu_ratio": statistics.median(cpu),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("program", type=Path, help="the learn crate's `steps` bench")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--precisions", nargs="+", choices=TARGETS, default=["f32"])
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--block", type=int, default=3, help="steps in a round")
    options = parser.parse_args()
    missed = False
    for name in options.cases:
        worst = check_same(options.program, CASES[name])
        print(f"{name}: the same losses within {worst:.0e} of their size", flush=True)
        for precision, threads in itertools.product(options.precisions, options.threads):
            found = measure(options.program, CASES[name], precision, threads, options.rounds, options.block)
            print(json.dumps({"case": name, "precision": precision, "threads": threads, **found}), flush=True)
            print(
                f"{name}, {precision}, {threads} thread(s), {found['parameters']} parameters: ours {found['ms']:.1f} ms "
                f"a step, {found['waited']:.0%} of it waiting for a processor"
            )
            for key, most in TARGETS[precision].items():
                peer = found["peers"][named(*key)]
                met = peer["ratio"] <= most
                missed |= not met
                print(
                    f"  {named(*key)}: {peer['ms']:.1f} ms, "
                    f"ratio {peer['ratio']:.3f} ({peer['ratio_least']:.3f} to {peer['ratio_most']:.3f}; "
                    f"processor time {peer['cpu_ratio']:.3f}), at most {most}: {'met' if met else 'MISSED'}",
                    flush=True,
                )
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
