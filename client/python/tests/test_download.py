"""Downloads: from a bucket by its URL, or from the server where the bucket does not give the file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import pytest
from blake3 import blake3

import gleaner
from conftest import TASK, Lab
from gleaner._download import Downloads, Expected, Reply, save

FILE = bytes(range(256)) * 10_000
PATHS = {"/whole": FILE, "/altered": FILE[:-1] + b"?", "/short": FILE[:100], "/long": FILE * 4}


def expected(file: bytes) -> Expected:
    """What a file with these bytes must be."""
    return SimpleNamespace(blake3=blake3(file).hexdigest(), size_bytes=len(file))


EXPECTED = expected(FILE)


class Bucket(BaseHTTPRequestHandler):
    """Files, one of them cut off, and a redirect."""

    def do_GET(self) -> None:
        found = PATHS.get(self.path)
        self.send_response(302 if self.path == "/elsewhere" else 404 if found is None else 200)
        self.send_header("Location", "/whole")
        self.send_header("Content-Length", str(len(FILE) if self.path == "/short" else len(found or b"")))
        self.end_headers()
        self.wfile.write(found or b"")

    def log_message(self, *_: object) -> None:
        """Prints nothing."""


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Bucket)
    Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


class Sender:
    """The server's side: a URL for those who accept one, and else the bytes in pieces."""

    def __init__(self, url: str, file: bytes = FILE) -> None:
        self.url, self.file, self.asked = url, file, list[bool]()

    def __call__(self, accept_url: bool) -> Iterator[Reply]:
        self.asked.append(accept_url)
        if accept_url and self.url:
            yield SimpleNamespace(data=b"", url=self.url)
        else:
            for at in range(0, len(self.file), 1_000_000):
                yield SimpleNamespace(data=self.file[at : at + 1_000_000], url="")


def test_file_comes_from_its_url(bucket: str, tmp_path: Path) -> None:
    sender, downloads = Sender(f"{bucket}/whole", b"not sent"), Downloads()
    for name in ("a", "b"):
        assert downloads.save(sender, tmp_path / name, EXPECTED).read_bytes() == FILE
    assert sender.asked == [True, True]


@pytest.mark.parametrize("path", ["/altered", "/short", "/long", "/absent", "/elsewhere"])
def test_file_that_its_url_does_not_give_comes_from_the_server(bucket: str, tmp_path: Path, path: str) -> None:
    sender, downloads = Sender(bucket + path), Downloads()
    for name in ("a", "b"):
        assert downloads.save(sender, tmp_path / name, EXPECTED).read_bytes() == FILE
    assert sender.asked == [True, False, False], "a bucket that failed just now is not asked"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a", "b"]


def test_bucket_that_failed_is_asked_again_after_a_rest(bucket: str, tmp_path: Path) -> None:
    downloads, failing, whole = Downloads(rest=0), Sender(f"{bucket}/absent"), Sender(f"{bucket}/whole", b"not sent")
    for sender in (failing, whole):
        assert downloads.save(sender, tmp_path / "a", EXPECTED).read_bytes() == FILE
    assert (failing.asked, whole.asked) == ([True, False], [True])


def test_more_bytes_than_a_file_has_are_not_read(tmp_path: Path) -> None:
    endless = iter(lambda: b"x" * 1000, None)
    with pytest.raises(gleaner.Damaged):
        save(endless, tmp_path / "a", expected(b"y" * 2500))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("url", ["http://127.0.0.1:1/x", f"file://{__file__}", "http://[", "nonsense"])
def test_unusable_url_is_no_error(tmp_path: Path, url: str) -> None:
    assert Downloads().save(Sender(url), tmp_path / "a", EXPECTED).read_bytes() == FILE


def test_bucket_without_encryption_is_not_asked_behind_a_server_with_it(bucket: str, tmp_path: Path) -> None:
    sender = Sender(f"{bucket}/whole")
    assert Downloads(encrypted=True).save(sender, tmp_path / "a", EXPECTED).read_bytes() == FILE
    assert sender.asked == [True, False]


def test_server_without_a_bucket_sends_the_bytes(tmp_path: Path) -> None:
    sender = Sender("")
    assert Downloads().save(sender, tmp_path / "a", EXPECTED).read_bytes() == FILE
    assert Downloads().save(Sender("", b""), tmp_path / "b", expected(b"")).read_bytes() == b""
    with pytest.raises(gleaner.Damaged):
        Downloads().save(Sender("", b"other"), tmp_path / "c", EXPECTED)
    assert sender.asked == [True]


def test_damage_at_both_is_an_error(bucket: str, tmp_path: Path) -> None:
    with pytest.raises(gleaner.Damaged):
        Downloads().save(Sender(f"{bucket}/altered", b"other"), tmp_path / "a", EXPECTED)
    assert list(tmp_path.iterdir()) == []


def test_a_file_may_have_the_longest_name(tmp_path: Path) -> None:
    path = tmp_path / ("a" * 250 + ".mcap")
    assert save([FILE], path, EXPECTED).read_bytes() == FILE
    assert [*tmp_path.iterdir()] == [path]


def test_downloads_to_one_path_do_not_disturb_each_other(tmp_path: Path) -> None:
    path = tmp_path / "a"

    def pieces() -> Iterator[bytes]:
        yield FILE[:1000]
        save([FILE], path, EXPECTED)
        yield FILE[1000:]

    assert save(pieces(), path, EXPECTED).read_bytes() == FILE
    assert [*tmp_path.iterdir()] == [path], "no part is left"


def test_recording_in_a_folder_replaces_no_other_file(
    client: gleaner.Client, lab: Lab, recordings: dict[str, list[Path]], tmp_path: Path
) -> None:
    del lab
    spec = client.tasks.get(TASK).spec
    spec.name = "equal_names"
    task = client.tasks.create(spec).id
    contents = [path.read_bytes() for path in recordings["wrong_goal"][:2]]
    episodes = []
    for number, content in enumerate(contents):
        path = tmp_path / f"day{number}" / "take.mcap"
        path.parent.mkdir()
        path.write_bytes(content)
        episodes.append(client.episodes.push(path, task=task, outcome="failure").id)
    folder = tmp_path / "folder"
    folder.mkdir()
    path = client.episodes.download(episodes[0], folder)
    assert path == folder / "take.mcap"
    with pytest.raises(FileExistsError, match=r"take\.mcap exists with another content; name a new file in place of"):
        client.episodes.download(episodes[1], folder)
    kept = path.stat()
    assert client.episodes.download(episodes[0], folder) == path
    assert (path.stat().st_ino, path.stat().st_mtime_ns) == (kept.st_ino, kept.st_mtime_ns), "it is not written again"
    assert path.read_bytes() == contents[0]
    assert client.episodes.download(episodes[1], path).read_bytes() == contents[1], "a named file is replaced"
    assert [*folder.iterdir()] == [path]


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("other", [FILE, b"of the user", None])
def test_file_that_comes_during_a_download_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool, other: bytes | None
) -> None:
    if not links:
        monkeypatch.setattr(os, "link", refused)
    path = tmp_path / "a"

    def pieces() -> Iterator[bytes]:
        yield FILE[:1000]
        if other is not None:
            path.write_bytes(other)
        yield FILE[1000:]

    if other in (FILE, None):
        assert save(pieces(), path, EXPECTED, replace=False) == path
    else:
        with pytest.raises(FileExistsError):
            save(pieces(), path, EXPECTED, replace=False)
    assert path.read_bytes() == (other or FILE)
    assert [*tmp_path.iterdir()] == [path], "no part is left"


def refused(*_: object) -> None:
    raise PermissionError("this disk has no links")


def test_folders_and_broken_links_count_as_other_files(tmp_path: Path) -> None:
    folder, link = tmp_path / "folder", tmp_path / "link"
    folder.mkdir()
    link.symlink_to(tmp_path / "nowhere")
    for path in (folder, link):
        with pytest.raises(FileExistsError):
            save([FILE], path, EXPECTED, replace=False)
    assert sorted(tmp_path.iterdir()) == [folder, link]
