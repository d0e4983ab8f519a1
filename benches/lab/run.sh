#!/usr/bin/env bash
# Builds the programs, makes a lab of 100,000 episodes and walks it. Arguments go to lab.py.
#
# BENCH_PROFILE is cargo's profile (bench). PYTHON is a Python with the package gleaner.
set -euo pipefail
cd "$(dirname "$0")/../.."

. benches/programs.sh
build gleaner-cli
"${CARGO:-cargo}" build --locked --profile "$profile" -p gleaner-worker --example recordings

# Other load on the machine affects times more than ratios.
uptime
exec "${PYTHON:-python3}" benches/lab/lab.py --bin "$folder" --recordings "$folder/examples/recordings" "$@"
