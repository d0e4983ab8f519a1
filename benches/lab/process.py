"""A server in a process of its own, with the most memory that it takes during each piece of work."""

import os
import pathlib
import subprocess


class Server:
    """A server that is stopped by a signal, as an operator stops it. After a failure in its `with` block it is killed."""

    def __init__(self, bin: pathlib.Path, data: pathlib.Path, workers: int, *flags: str):
        command = [bin / "gleaner-server", "--log", "warn", "serve", "--data-dir", data, "--listen", "127.0.0.1:0"]
        command += ["--web-listen", "127.0.0.1:0", "--workers", str(workers), *flags]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            self.pages, self.url = self._address("pages on "), self._address("listening on ")
        except BaseException:
            self.kill()
            raise

    def __enter__(self) -> "Server":
        return self

    def __exit__(self, failure: type[BaseException] | None, *_: object) -> None:
        if failure is None:
            self.stop()
        else:
            self.kill()

    def _address(self, beginning: str) -> str:
        """The address on the next line with this beginning."""
        for line in self.process.stdout:
            if line.startswith(beginning):
                return line.split()[-1]
        raise SystemExit(f"the server ended with {self.process.wait()} and without the line {beginning!r}")

    def forget_peak(self) -> None:
        """Measures the peak of memory from here on."""
        pathlib.Path(f"/proc/{self.process.pid}/clear_refs").write_text("5")

    def peak_mib(self) -> float:
        """The most memory held since then, in MiB; memory that is mapped from files counts too."""
        return _status(self.process.pid, "VmHWM")

    def child_peak_mib(self, name: str) -> float:
        """The peak memory of the child of this name, in MiB; 0 without such a child."""
        peaks = []
        threads = pathlib.Path(f"/proc/{self.process.pid}/task").glob("*/children")
        for pid in " ".join(thread.read_text() for thread in threads).split():
            try:
                if pathlib.Path(f"/proc/{pid}/comm").read_text().startswith(name[:15]):
                    peaks.append(_status(int(pid), "VmHWM"))
            except OSError:
                continue  # It has ended.
        return max(peaks, default=0.0)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def stop(self) -> None:
        self.process.terminate()
        if self.process.wait() != 0:
            raise SystemExit("the server did not end well")


def client(bin: pathlib.Path, server: Server, folder: pathlib.Path, *words: str) -> str:
    """The output of a command of the client, as JSON."""
    env = {**os.environ, "GLEANER_SERVER": server.url}
    command = [bin / "gleaner", *words, "--json"]
    return subprocess.run(command, cwd=folder, env=env, check=True, stdout=subprocess.PIPE, text=True).stdout


def _status(pid: int, name: str) -> float:
    for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) / 1024
    return 0.0
