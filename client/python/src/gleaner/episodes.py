"""Episodes: recordings in, with their labels."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from gleaner._download import Downloads, holds, inside
from gleaner._messages import number
from gleaner._pages import PAGE, pages
from gleaner._proto.v1 import episode_pb2 as pb
from gleaner._rpc import Rpc
from gleaner._summary import summarize
from gleaner._upload import Upload, digest, name_to_send, regular
from gleaner.types import Episode, InspectionEstimate, Label, Report

_PAGE = 500


class Episodes:
    """`client.episodes`."""

    def __init__(self, rpc: Rpc) -> None:
        self._rpc, self._downloads = rpc, Downloads(encrypted=rpc.encrypted)

    def push(
        self,
        path: str | os.PathLike[str],
        *,
        task: str,
        outcome: str,
        cohort: str = "",
        author: str = "",
        progress: Callable[[int], object] = lambda sent: None,
    ) -> Episode:
        """Uploads a recording (MCAP) under a label: `outcome` is success, failure or unknown.

        The parts of a recording that its recorder has cut are joined and pushed by the command `gleaner push` only.
        A broken connection is reopened and the upload resumes where it was. Content that the task holds already
        under this label, or under any if `outcome` is unknown and `cohort` empty, is not sent again. `progress` is
        called with the bytes sent so far.

        Raises `InvalidArgument` when the recording does not fit the task (each finding with its fix), `NotFound`
        without such a task, `AlreadyExists` when the content is there under another label, and `ResourceExhausted` when
        the recording states, before its first byte, that it is above a limit of the server.
        """
        path = regular(Path(path))
        start = _start(path, task, outcome, cohort)
        start.author = author
        return Upload(self._rpc, path, start, progress).run()

    def check(
        self, path: str | os.PathLike[str], *, task: str, outcome: str, cohort: str = ""
    ) -> InspectionEstimate | None:
        """Checks a recording as `push` would, and sends none of its bytes.

        Returns what its inspection takes by what the recording states about itself, or `None` if it states nothing.
        The inspection of a push can still reject it. Raises as `push` before its first byte.
        """
        start = _start(regular(Path(path)), task, outcome, cohort)
        start.validate_only = True
        reply = self._rpc.unary("EpisodeService/StartUpload", start, pb.StartUploadResponse)
        return reply.estimate if reply.HasField("estimate") else None

    def get(self, episode_id: str) -> Episode:
        """Returns an episode. Raises `NotFound`."""
        return self._get(episode_id).episode

    def report(self, episode_id: str) -> Report:
        """The report of the inspection of an episode's recording. Raises `NotFound`."""
        return self._get(episode_id).report

    def label(
        self,
        episode_ids: str | Iterable[str],
        outcome: str | None = None,
        *,
        cohort: str | None = None,
        author: str = "",
        reason: str = "",
    ) -> list[Episode]:
        """Sets the outcome, the cohort or both of one or many episodes at once; each change is kept."""
        ids = _ids(episode_ids)
        wire = None if outcome is None else number(pb.LabelEpisodesRequest, "outcome", outcome)
        request = pb.LabelEpisodesRequest(episode_ids=ids, outcome=wire, cohort=cohort, author=author, reason=reason)
        reply = self._rpc.unary("EpisodeService/LabelEpisodes", request, pb.LabelEpisodesResponse)
        return [*reply.episodes]

    def labels(self, episode_id: str) -> list[Label]:
        """The history of an episode's labels, oldest first."""
        request = pb.ListLabelsRequest(episode_id=episode_id, page_size=PAGE)
        found = pages(self._rpc, "EpisodeService/ListLabels", request, pb.ListLabelsResponse)
        return [label for page in found for label in page.labels]

    def delete(self, episode_ids: str | Iterable[str], *, force: bool = False) -> list[Episode]:
        """Moves one or many episodes to the trash, all or none: lists and new snapshots exclude them.

        `undelete` restores them until the server's sweep removes them permanently. Raises `FailedPrecondition` when a
        snapshot holds one; `force` deletes it nevertheless: its results can then not be reproduced.
        """
        request = pb.DeleteEpisodesRequest(episode_ids=_ids(episode_ids), force=force)
        return [*self._rpc.unary("EpisodeService/DeleteEpisodes", request, pb.DeleteEpisodesResponse).episodes]

    def undelete(self, episode_ids: str | Iterable[str]) -> list[Episode]:
        """Restores one or many episodes from the trash, all or none. Raises `NotFound` when one was removed."""
        request = pb.UndeleteEpisodesRequest(episode_ids=_ids(episode_ids))
        return [*self._rpc.unary("EpisodeService/UndeleteEpisodes", request, pb.UndeleteEpisodesResponse).episodes]

    def download(self, episode_id: str, path: str | os.PathLike[str]) -> Path:
        """Downloads a recording as uploaded. `path` is a file, which is replaced, or an existing folder for it.

        It comes from the server's bucket where the server gives a URL of it, and otherwise from the server. In a folder
        it has the name under which it was uploaded; if it is there already, it is not downloaded again.

        Raises `Damaged` when the digest differs; the file appears only complete. Raises `FileExistsError` when the
        folder has another file of this name, such as that of an episode with the same file name: name a file then.
        """
        episode = self.get(episode_id)
        path = Path(path)
        folder = path.is_dir()
        if folder:
            path = inside(path, episode.file_name, f"{episode_id}.mcap")
            if holds(path, episode):
                return path

        def start(accept_url: bool) -> Iterator[pb.DownloadEpisodeResponse]:
            request = pb.DownloadEpisodeRequest(episode_id=episode_id, accept_url=accept_url)
            return self._rpc.stream("EpisodeService/DownloadEpisode", request, pb.DownloadEpisodeResponse)

        return self._downloads.save(start, path, episode, replace=not folder)

    def list(
        self, task: str, *, outcome: str | None = None, cohort: str = "", deleted: bool = False
    ) -> Iterator[Episode]:
        """A task's episodes, or those in the trash, oldest first; fetched lazily, page by page."""
        request = pb.ListEpisodesRequest(task=task, cohort=cohort, page_size=_PAGE, deleted=deleted)
        if outcome is not None:
            request.outcome = number(pb.ListEpisodesRequest, "outcome", outcome)
        while True:
            reply = self._rpc.safe("EpisodeService/ListEpisodes", request, pb.ListEpisodesResponse)
            yield from reply.episodes
            if not reply.next_page_token:
                return
            request.page_token = reply.next_page_token

    def _get(self, episode_id: str) -> pb.GetEpisodeResponse:
        request = pb.GetEpisodeRequest(episode_id=episode_id)
        return self._rpc.safe("EpisodeService/GetEpisode", request, pb.GetEpisodeResponse)


def _start(path: Path, task: str, outcome: str, cohort: str) -> pb.StartUploadRequest:
    return pb.StartUploadRequest(
        task=task,
        file_name=name_to_send(path),
        size_bytes=path.stat().st_size,
        blake3=digest(path),
        outcome=number(pb.StartUploadRequest, "outcome", outcome),
        cohort=cohort,
        summary=summarize(path),
    )


def _ids(episode_ids: str | Iterable[str]) -> list[str]:
    return [episode_ids] if isinstance(episode_ids, str) else [*episode_ids]
