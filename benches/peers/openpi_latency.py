"""Round trips of openpi's own client: gleaner beside openpi's server loop in eager PyTorch, with the same network.

Both servers run the checkpoint that gleaner has trained; first both must give the same actions. Then they take turns, and
medians and their ratios are printed; ends with 1 if the target is missed.
"""

import argparse
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import gleaner
import numpy as np
from openpi_client.websocket_client_policy import WebsocketClientPolicy
from safetensors import SafetensorError, safe_open

TASK, DEPLOYMENT = "pick_openpi", "pick_openpi@bench"
# Median of openpi's loop over gleaner's.
TARGET = 3.0
SIDE = 128
# Observations whose actions must be equal, and by how much they may differ.
COMPARED, TOLERANCE = 16, 1e-4
WARM_UP = 20


class Program:
    """A server that prints the addresses on which it listens."""

    def __init__(self, *command: str | pathlib.Path):
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.addresses: dict[str, str] = {}

    def address(self, line: str) -> str:
        """The address that a line with this beginning names."""
        for printed in self.process.stdout:
            name, _, address = printed.strip().rpartition(" ")
            self.addresses[name] = address
            if name == line:
                return address
        raise SystemExit(f"{self.process.args[0]} ended before it was {line}")

    def stop(self) -> None:
        self.process.terminate()
        self.process.wait()


def deploy(client: gleaner.Client, bin: pathlib.Path, server: str, folder: pathlib.Path, preset: str) -> None:
    """A finetuned policy of two cameras of 128 × 128; its cost does not depend on how long it was trained."""
    command = lambda *words: subprocess.run([bin / "gleaner", *words], check=True, stdout=subprocess.DEVNULL)
    command("record", "--out", folder / "recordings", "--image", str(SIDE), "--agent", "expert:2", "--agent", "wrong_goal:2")
    command("--server", server, "task", "create", "--sim", "pick_cube")
    spec = client.tasks.get("pick_cube").spec
    spec.name = TASK
    for camera in spec.cameras:
        camera.height, camera.width, camera.depth = SIDE, SIDE, False
    for mapping in spec.mappings:
        for camera in mapping.cameras:
            camera.ClearField("depth")
    # The peer does not know the bounds of actions.
    for field in spec.action:
        for bound in ("minimum", "maximum", "binary"):
            field.ClearField(bound)
    client.tasks.create(spec)
    for path in sorted((folder / "recordings").glob("*.mcap")):
        client.episodes.push(path, task=TASK, outcome="success" if "expert" in path.stem else "failure")
    # The PyTorch model beside it has this token.
    pretrain = client.jobs.pretrain(TASK, preset=preset, steps=4, batch=8, action_token="proprioception")
    encoder = client.jobs.wait(pretrain).result_id
    policy = client.jobs.train(TASK, experts_of=encoder, policy="finetune", steps=4, batch=8)
    client.deploy(DEPLOYMENT, client.jobs.wait(policy).result_id)


def checkpoint(blobs: pathlib.Path) -> pathlib.Path:
    """The only policy among a server's blobs: its header names the kind of the policy."""
    for path in sorted(blobs.glob("*/*")):
        try:
            with safe_open(path, "pt") as opened:
                header = opened.metadata() or {}
        except (SafetensorError, OSError):
            continue
        if '"policy":"finetune"' in header.get("gleaner", "").replace(" ", ""):
            return path
    raise SystemExit(f"{blobs} has no policy")


def observations(spec: gleaner.types.TaskSpec) -> list[dict[str, np.ndarray]]:
    chance = np.random.default_rng(0)
    state = sum(field.size for field in spec.proprioception)
    return [
        {
            **{f"observation/{camera.name}": chance.integers(0, 256, (SIDE, SIDE, 3), np.uint8) for camera in spec.cameras},
            "observation/state": chance.normal(0, 0.3, state).astype(np.float32),
            "prompt": "pick the cube",
        }
        for _ in range(COMPARED)
    ]


def times(client: WebsocketClientPolicy, seen: list[dict[str, np.ndarray]], seconds: float) -> list[float]:
    """Milliseconds of each round trip."""
    for at in range(WARM_UP):
        client.infer(seen[at % len(seen)])
    found, end = [], time.perf_counter() + seconds
    while time.perf_counter() < end:
        begun = time.perf_counter()
        client.infer(seen[len(found) % len(seen)])
        found.append((time.perf_counter() - begun) * 1e3)
    return found


def measured(servers: dict[str, str], seen: list[dict[str, np.ndarray]], given: argparse.Namespace) -> bool:
    """Prints the table; whether the target was met."""
    clients = {name: WebsocketClientPolicy(address) for name, address in servers.items()}
    ours, theirs = ([client.infer(step)["actions"][0] for step in seen] for client in clients.values())
    worst = float(np.abs(np.array(ours) - np.array(theirs)).max())
    if worst > TOLERANCE:
        raise SystemExit(f"the servers give actions that differ by {worst:.0e}, more than {TOLERANCE:.0e}")
    rounds: dict[str, list[list[float]]] = {name: [] for name in clients}
    for _ in range(given.rounds):
        for name, client in clients.items():
            rounds[name].append(times(client, seen, given.seconds))
    medians = {name: [statistics.median(found) for found in of] for name, of in rounds.items()}
    print(f"\n`{given.preset}`, actions equal within {worst:.0e}; {given.rounds} rounds of {given.seconds:g} s, in turns:\n")
    print("| | p50 | p99 |\n|---|---:|---:|")
    for name, of in rounds.items():
        p99 = statistics.median(float(np.quantile(found, 0.99)) for found in of)
        print(f"| {name} | {statistics.median(medians[name]):.2f} ms | {p99:.2f} ms |")
    ratio = statistics.median(theirs / ours for ours, theirs in zip(*medians.values(), strict=True))
    met = ratio >= TARGET
    print(f"\nopenpi's p50 over gleaner's: {ratio:.1f}, at least {TARGET}: {'met' if met else 'MISSED'}")
    return met


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bin", type=pathlib.Path, required=True, help="where the programs are")
    parser.add_argument("--preset", default="tiny", help="size of the policy")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=3, help="of each server in each round")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        flags = ["--data-dir", folder / "data", "--listen", "127.0.0.1:0", "--openpi-listen", "127.0.0.1:0"]
        flags += ["--worker-threads", "1"]
        programs = [Program(given.bin / "gleaner-server", "--log", "warn", "serve", *flags)]
        try:
            openpi = programs[0].address("clients of openpi on")
            address = programs[0].address("listening on")
            with gleaner.connect(address) as client:
                deploy(client, given.bin.resolve(), address, folder, given.preset)
                seen = observations(client.tasks.get(TASK).spec)
            found = checkpoint(folder / "data" / "blobs")
            peer = pathlib.Path(__file__).parent / "serve_openpi.py"
            programs.append(Program(sys.executable, "-B", peer, "--checkpoint", found))
            servers = {
                "gleaner": f"{openpi}/{DEPLOYMENT}",
                "openpi's loop and PyTorch": programs[1].address("listening on"),
            }
            met = measured(servers, seen, given)
        finally:
            for program in reversed(programs):
                program.stop()
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
