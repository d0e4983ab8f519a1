#!/usr/bin/env bash
# Latency of openpi's own client with gleaner and with openpi's server loop, in one run. Arguments go to openpi_latency.py.
#
# BENCH_PROFILE is cargo's profile (bench), PEERS_VENV where the virtual environment is or shall be.
set -euo pipefail
cd "$(dirname "$0")/../.."
. benches/peers/environment.sh

profile="${BENCH_PROFILE:-bench}"
"${CARGO:-cargo}" build --locked --profile "$profile" -p gleaner-server -p gleaner-inspector -p gleaner-worker -p gleaner-cli
case "$profile" in
  dev) folder=target/debug ;;
  bench) folder=target/release ;;
  *) folder="target/$profile" ;;
esac
"$python" -m pip install --quiet --disable-pip-version-check --no-deps client/python

# Other load on the machine affects times more than ratios.
uptime
exec "$python" -B benches/peers/openpi_latency.py --bin "$folder" "$@"
