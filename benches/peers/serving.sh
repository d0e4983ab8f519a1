#!/usr/bin/env bash
# Our server beside others that run the same network, in one run. Arguments go to bench-serving; see README.md.
#
# BENCH_PROFILE is cargo's profile (bench), PEERS_VENV where the virtual environment is or shall be.
set -euo pipefail
cd "$(dirname "$0")/../.."
. benches/peers/environment.sh

generated=target/peers
mkdir -p "$generated"
"$python" -m grpc_tools.protoc -I proto --python_out="$generated" --grpc_python_out="$generated" proto/gleaner/v1/*.proto
benches/serving/run.sh --parts peers --python "$python" --peers-generated "$generated" "$@"
