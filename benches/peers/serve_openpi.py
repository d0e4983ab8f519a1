"""The policy behind openpi's server loop: metadata first, msgpack maps of numpy arrays, inference in the handler.

Speaks to `openpi_client` as openpi's own server does: it answers one request after the other, and a failure is a text
with the traceback before the connection closes.
"""

import asyncio
import http
import time
import traceback

import torch
from openpi_client import msgpack_numpy
from websockets.asyncio.server import Request, Response, ServerConnection, serve
from websockets.frames import CloseCode

from serving_policy import Policy, from_command_line


async def attend(policy: Policy, socket: ServerConnection) -> None:
    """One robot, from its greeting until it hangs up."""
    packer, episode, before = msgpack_numpy.Packer(), policy.episode(), None
    await socket.send(packer.pack({"cameras": policy.cameras}))
    async for message in socket:
        begun = time.monotonic()
        try:
            seen = msgpack_numpy.unpackb(message)
            frames = [seen[f"observation/{name}"].tobytes() for name in policy.cameras]
            action = episode.act(frames, torch.from_numpy(seen["observation/state"].copy()))
        except Exception:
            await socket.send(traceback.format_exc())
            await socket.close(CloseCode.INTERNAL_ERROR, "the policy failed")
            raise
        timing = {"infer_ms": (time.monotonic() - begun) * 1e3}
        if before is not None:
            timing["prev_total_ms"] = before * 1e3
        await socket.send(packer.pack({"actions": action.numpy()[None], "server_timing": timing}))
        before = time.monotonic() - begun


def health(connection: ServerConnection, request: Request) -> Response | None:
    return connection.respond(http.HTTPStatus.OK, "OK\n") if request.path == "/healthz" else None


async def main() -> None:
    policy = from_command_line(__doc__)
    handler = lambda socket: attend(policy, socket)
    async with serve(handler, "127.0.0.1", 0, compression=None, max_size=None, process_request=health) as server:
        port = server.sockets[0].getsockname()[1]
        print(f"listening on ws://127.0.0.1:{port}", flush=True)
        await server.serve_forever()


if __name__ == "__main__":
    asyncio.run(main())
