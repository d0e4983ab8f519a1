"""The policy behind grpc.aio: the same Session rpc as our server's, so that the same client measures both.

Needs the Python code that grpc_tools generates from the .proto files on its path.
"""

import asyncio

import grpc
import torch
from gleaner.v1 import policy_pb2, policy_pb2_grpc

from serving_policy import Policy, from_command_line


class Service(policy_pb2_grpc.PolicyServiceServicer):
    def __init__(self, policy: Policy):
        self.policy = policy

    async def Session(self, requests, context):
        episode = self.policy.episode()
        async for request in requests:
            which = request.WhichOneof("message")
            if which == "open":
                yield policy_pb2.SessionResponse(opened=policy_pb2.SessionOpened(session_id="peer"))
            elif which == "observation":
                yield self.answer(episode, request.observation)
            else:
                yield policy_pb2.SessionResponse(closed=policy_pb2.SessionClosed())
                return

    def answer(self, episode, observation) -> policy_pb2.SessionResponse:
        frames = {frame.camera: frame.color.data for frame in observation.cameras}
        state = torch.tensor(observation.proprioception)
        action = episode.act([frames[name] for name in self.policy.cameras], state)
        step = policy_pb2.ActionStep(values=action.tolist())
        said = policy_pb2.SessionAction(observation_stamp_ns=observation.stamp_ns, actions=[step])
        return policy_pb2.SessionResponse(action=said)


async def main() -> None:
    policy = from_command_line(__doc__)
    server = grpc.aio.server()
    policy_pb2_grpc.add_PolicyServiceServicer_to_server(Service(policy), server)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    print(f"listening on http://127.0.0.1:{port}", flush=True)
    await server.wait_for_termination()


if __name__ == "__main__":
    asyncio.run(main())
