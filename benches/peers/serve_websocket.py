"""The policy behind a WebSocket, in the way of openpi's server: msgpack maps, no compression, inference in the
handler.
"""

import asyncio
import time

import msgpack
import numpy as np
import torch
from websockets.asyncio.server import ServerConnection, serve

from serving_policy import Policy, from_command_line


def array(packed: dict) -> np.ndarray:
    return np.frombuffer(packed["data"], dtype=packed["dtype"])


async def attend(policy: Policy, socket: ServerConnection) -> None:
    """One robot, from its greeting until it hangs up."""
    episode = policy.episode()
    await socket.send(msgpack.packb({"cameras": policy.cameras, "window": policy.window}))
    async for message in socket:
        begun = time.monotonic()
        observation = msgpack.unpackb(message)
        frames = [observation[f"image/{name}"]["data"] for name in policy.cameras]
        action = episode.act(frames, torch.from_numpy(array(observation["state"]).copy()))
        actions = {"dtype": "<f4", "data": action.numpy().astype("<f4").tobytes()}
        timing = {"infer_ms": (time.monotonic() - begun) * 1e3}
        await socket.send(msgpack.packb({"actions": actions, "server_timing": timing}))


async def main() -> None:
    policy = from_command_line(__doc__)
    handler = lambda socket: attend(policy, socket)
    async with serve(handler, "127.0.0.1", 0, compression=None, max_size=None) as server:
        port = server.sockets[0].getsockname()[1]
        print(f"listening on ws://127.0.0.1:{port}", flush=True)
        await server.serve_forever()


if __name__ == "__main__":
    asyncio.run(main())
