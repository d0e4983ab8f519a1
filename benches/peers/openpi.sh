#!/usr/bin/env bash
# Latency of openpi's own client with gleaner and with openpi's server loop, in one run. Arguments go to openpi_latency.py.
#
# BENCH_PROFILE is cargo's profile (bench), PEERS_VENV where the virtual environment is or shall be.
set -euo pipefail
cd "$(dirname "$0")/../.."
. benches/peers/environment.sh

. benches/programs.sh
build gleaner-cli
"$python" -m pip install --quiet --disable-pip-version-check --no-deps client/python

# Other load on the machine affects times more than ratios.
uptime
exec "$python" -B benches/peers/openpi_latency.py --bin "$folder" "$@"
