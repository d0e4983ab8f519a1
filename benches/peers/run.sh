#!/usr/bin/env bash
# Our pretraining step beside eager PyTorch's, in one run. Arguments go to the script; see README.md.
#
# BENCH_PROFILE is cargo's profile (bench), PEERS_VENV where the virtual environment is or shall be, PEERS_SCRIPT the script
# (compare.py).
set -euo pipefail
cd "$(dirname "$0")/../.."

. benches/peers/environment.sh

program=$("${CARGO:-cargo}" bench --locked -p gleaner-learn --bench steps --profile "${BENCH_PROFILE:-bench}" \
  --no-run --message-format json-render-diagnostics |
  "$python" -c 'import json, sys
made = [json.loads(line).get("executable") for line in sys.stdin if line.startswith("{")]
print([path for path in made if path][-1])')

# What else the machine does matters to the clock, less to the ratios.
uptime
exec "$python" -B "benches/peers/${PEERS_SCRIPT:-compare.py}" "$program" "$@"
