#!/usr/bin/env bash
# Builds the server and the load test, and runs it. Arguments are passed to load-test.
#
# BENCH_PROFILE is cargo's profile (bench).
set -euo pipefail
cd "$(dirname "$0")/../.."

. benches/programs.sh
build gleaner-bench-load

# Other load on the machine affects times more than ratios.
uptime
exec "$folder/load-test" --server-bin "$folder/gleaner-server" "$@"
