#!/usr/bin/env bash
# Builds the server and asks for every page on a large lab's database. Arguments go to pages.py.
#
# BENCH_PROFILE is cargo's profile (bench).
set -euo pipefail
cd "$(dirname "$0")/../.."

profile="${BENCH_PROFILE:-bench}"
"${CARGO:-cargo}" build --locked --profile "$profile" -p gleaner-server -p gleaner-inspector -p gleaner-worker -p gleaner-cli
case "$profile" in
  dev) folder=target/debug ;;
  bench) folder=target/release ;;
  *) folder="target/$profile" ;;
esac
exec python3 benches/pages/pages.py --bin "$folder" "$@"
