#!/usr/bin/env bash
# Builds the server and the load, and loads. Arguments go to load-test.
#
# BENCH_PROFILE is cargo's profile (bench).
set -euo pipefail
cd "$(dirname "$0")/../.."

profile="${BENCH_PROFILE:-bench}"
"${CARGO:-cargo}" build --locked --profile "$profile" -p gleaner-server -p gleaner-inspector -p gleaner-worker -p gleaner-bench-load
# cargo keeps these two profiles' files in the folders of the profiles they come from.
case "$profile" in
  dev) folder=target/debug ;;
  bench) folder=target/release ;;
  *) folder="target/$profile" ;;
esac

# What else the machine does matters to the clock, less to the ratios.
uptime
exec "$folder/load-test" --server-bin "$folder/gleaner-server" "$@"
