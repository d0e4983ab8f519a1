#!/usr/bin/env bash
# Builds the server and the benchmark, and runs it. Arguments are passed to bench-serving.
#
# BENCH_PROFILE is cargo's profile (bench).
set -euo pipefail
cd "$(dirname "$0")/../.."

profile="${BENCH_PROFILE:-bench}"
"${CARGO:-cargo}" build --locked --profile "$profile" -p gleaner-server -p gleaner-inspector -p gleaner-worker -p gleaner-bench-serving
# cargo uses the folders of the parent profiles for these two.
case "$profile" in
  dev) folder=target/debug ;;
  bench) folder=target/release ;;
  *) folder="target/$profile" ;;
esac

# Other load on the machine affects times more than ratios.
uptime
exec "$folder/bench-serving" --server-bin "$folder/gleaner-server" "$@"
