#!/usr/bin/env bash
# Builds the server and the benchmark, and runs it. Arguments are passed to bench-serving.
#
# BENCH_PROFILE is cargo's profile (bench).
set -euo pipefail
cd "$(dirname "$0")/../.."

. benches/programs.sh
build gleaner-bench-serving

# Other load on the machine affects times more than ratios.
uptime
exec "$folder/bench-serving" --server-bin "$folder/gleaner-server" "$@"
